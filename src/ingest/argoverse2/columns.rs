//! The columns of a scenario file, whatever encoding its writer chose.

use crate::containment::contained;
use arrow::array::{Array, ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow::compute::{cast, concat_batches};
use arrow::datatypes::DataType;
use parquet::DecodeResult;
use parquet::arrow::push_decoder::ParquetPushDecoderBuilder;
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaDataPushDecoder;
use std::sync::Arc;

/// A scenario has some hundred tracks of at most 110 rows.
const MAX_ROWS: usize = 1 << 17;

/// The whole table of a file in memory.
pub(super) struct Table(RecordBatch);

impl Table {
    /// Decodes a parquet file. The error says what is wrong with it.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, String> {
        contained(|| decode(bytes)).unwrap_or_else(|| Err("the file is damaged beyond decoding".to_owned())).map(Self)
    }

    /// Number of rows.
    pub(super) fn n_rows(&self) -> usize {
        self.0.num_rows()
    }

    /// The names in `names` that are no columns.
    pub(super) fn missing<'a>(&self, names: &[&'a str]) -> Vec<&'a str> {
        names.iter().copied().filter(|name| self.0.column_by_name(name).is_none()).collect()
    }

    /// A column of text (plain, large, view or dictionary), or of whole numbers, which are names as well.
    pub(super) fn text(&self, name: &str) -> Result<StringArray, String> {
        let is_text = |found: &DataType| is_string(found) || found.is_integer();
        self.column(name, &DataType::Utf8, "text", is_text)?.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
    }

    /// A column of numbers of any width.
    pub(super) fn float(&self, name: &str) -> Result<Float64Array, String> {
        let column = self.column(name, &DataType::Float64, "numbers", DataType::is_numeric)?;
        column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
    }

    /// A column of whole numbers of any width, which may be kept as floating-point numbers.
    pub(super) fn integer(&self, name: &str) -> Result<Int64Array, String> {
        if self.0.column_by_name(name).is_some_and(|column| column.data_type().is_floating()) {
            let numbers = self.float(name)?;
            if let Some(row) = numbers.values().iter().position(|number| number.fract() != 0.0) {
                return Err(format!("column {name} is {} in row {row}, expected a whole number", numbers.value(row)));
            }
        }
        let column = self.column(name, &DataType::Int64, "whole numbers", DataType::is_numeric)?;
        column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
    }

    /// The column in type `wanted`, without missing values. Only types that are `accepted` are converted: text that looks like
    /// numbers is another table than this one, or a broken one.
    fn column(
        &self,
        name: &str,
        wanted: &DataType,
        expected: &str,
        accepted: impl Fn(&DataType) -> bool,
    ) -> Result<ArrayRef, String> {
        let column = self.0.column_by_name(name).ok_or_else(|| format!("no column {name}"))?;
        let found = match column.data_type() {
            DataType::Dictionary(_, values) => values,
            plain => plain,
        };
        if !accepted(found) {
            return Err(format!("column {name} is of type {}, expected {expected}", column.data_type()));
        }
        let column = cast(column, wanted).map_err(|error| format!("column {name}: {error}"))?;
        match (0..column.len()).find(|row| column.is_null(*row)) {
            Some(row) => Err(format!("column {name} has no value in row {row}")),
            None => Ok(column),
        }
    }
}

const fn is_string(found: &DataType) -> bool {
    matches!(found, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
}

fn lost(name: &str) -> String {
    format!("column {name} cannot be converted")
}

fn decode(bytes: &[u8]) -> Result<RecordBatch, String> {
    let explain = |error: ParquetError| error.to_string();
    let whole = 0..bytes.len() as u64;
    let mut metadata_decoder = ParquetMetaDataPushDecoder::try_new(whole.end).map_err(explain)?;
    metadata_decoder.push_range(whole.clone(), bytes.to_vec().into()).map_err(explain)?;
    let DecodeResult::Data(metadata) = metadata_decoder.try_decode().map_err(explain)? else {
        return Err("the file is cut short".to_owned());
    };
    let n_rows = metadata.file_metadata().num_rows();
    if !(0..=MAX_ROWS as i64).contains(&n_rows) {
        return Err(format!("{n_rows} rows, expected at most {MAX_ROWS}"));
    }
    let mut decoder = ParquetPushDecoderBuilder::try_new_decoder(Arc::new(metadata))
        .and_then(|builder| builder.with_batch_size(MAX_ROWS).build())
        .map_err(explain)?;
    decoder.push_range(whole, bytes.to_vec().into()).map_err(explain)?;
    let mut batches = Vec::new();
    loop {
        match decoder.try_decode().map_err(explain)? {
            DecodeResult::Data(batch) => batches.push(batch),
            DecodeResult::NeedsData(_) => return Err("the file refers to bytes it does not hold".to_owned()),
            DecodeResult::Finished => break,
        }
    }
    let first = batches.first().ok_or("the file has no rows")?;
    concat_batches(&first.schema(), &batches).map_err(|error| error.to_string())
}
