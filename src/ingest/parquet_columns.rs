//! The columns of a Parquet file, in any encoding.

use super::error::Malformed;
use crate::containment::contained;
use arrow::array::{Array, ArrayRef, AsArray, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow::compute::{cast, concat_batches};
use arrow::datatypes::{DataType, FieldRef, Fields, Schema, SchemaRef};
use parquet::DecodeResult;
use parquet::arrow::arrow_reader::ArrowReaderOptions;
use parquet::arrow::push_decoder::{ParquetPushDecoder, ParquetPushDecoderBuilder};
use parquet::arrow::{ProjectionMask, parquet_to_arrow_schema};
use parquet::file::metadata::{PageIndexPolicy, ParquetMetaData, ParquetMetaDataPushDecoder};
use std::io::{BufRead, Read};
use std::ops::Range;
use std::sync::Arc;

/// Limits of a file, since a small one may hold gigabytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    pub(super) n_rows: usize,
    /// Bytes of its columns, and of the text in one of them.
    pub(super) n_bytes: usize,
}

/// Some columns of a file in memory.
pub(super) struct Columns {
    batch: RecordBatch,
    /// The names of all columns of the file.
    names: Vec<String>,
    max_text_bytes: usize,
}

impl Columns {
    /// Decodes the columns of a Parquet file with these `names`; those in `numbers` must be numbers.
    pub(super) fn read(bytes: &[u8], names: &[&str], numbers: &[&str], limits: Limits) -> Result<Self, Malformed> {
        let damaged = || Err("the file is damaged beyond decoding".into());
        let decoded = contained(|| decode(bytes, names, numbers, limits)).unwrap_or_else(damaged)?;
        let (batch, names) = decoded;
        Ok(Self { batch, names, max_text_bytes: limits.n_bytes })
    }

    /// Number of rows.
    pub(super) fn n_rows(&self) -> usize {
        self.batch.num_rows()
    }

    /// The entries of `names` that are not columns.
    pub(super) fn missing<'a>(&self, names: &[&'a str]) -> Vec<&'a str> {
        names.iter().copied().filter(|name| self.batch.column_by_name(name).is_none()).collect()
    }

    /// A column of text (plain, large, view or dictionary), or of whole numbers, which can be names, too.
    pub(super) fn text(&self, name: &str) -> Result<StringArray, Malformed> {
        let column = self.text_or_null(name)?;
        without_null(name, &column)?;
        Ok(column)
    }

    /// A column of numbers of any width.
    pub(super) fn float(&self, name: &str) -> Result<Float64Array, Malformed> {
        let column = self.column(name, &DataType::Float64, "numbers", DataType::is_numeric)?;
        column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
    }

    /// A column of whole numbers of any width, which may be stored as floating-point numbers.
    pub(super) fn integer(&self, name: &str) -> Result<Int64Array, Malformed> {
        if self.batch.column_by_name(name).is_some_and(|column| column.data_type().is_floating()) {
            let numbers = self.float(name)?;
            if let Some(row) = numbers.values().iter().position(|number| number.fract() != 0.0) {
                let number = numbers.value(row);
                return Err(format!("column {name} is {number} in row {row}, expected a whole number").into());
            }
        }
        let column = self.column(name, &DataType::Int64, "whole numbers", DataType::is_numeric)?;
        column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
    }

    /// A column of numbers of any width; missing ones are NaN.
    pub(super) fn float_or_nan(&self, name: &str) -> Result<Vec<f64>, Malformed> {
        let column = self.converted(name, &DataType::Float64, "numbers", DataType::is_numeric)?;
        let numbers: Float64Array = column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))?;
        Ok(numbers.iter().map(|number| number.unwrap_or(f64::NAN)).collect())
    }

    /// A column of text or whole numbers, some of which may be missing.
    pub(super) fn text_or_null(&self, name: &str) -> Result<StringArray, Malformed> {
        let is_text = |found: &DataType| is_string(found) || found.is_integer();
        let column = self.converted(name, &DataType::Utf8, "text", is_text)?;
        column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
    }

    /// The names of all columns of the file.
    pub(super) fn into_names(self) -> Vec<String> {
        self.names
    }

    /// The column in type `wanted`, without missing values.
    fn column(
        &self,
        name: &str,
        wanted: &DataType,
        expected: &str,
        accepted: impl Fn(&DataType) -> bool,
    ) -> Result<ArrayRef, Malformed> {
        let column = self.converted(name, wanted, expected, accepted)?;
        without_null(name, &column)?;
        Ok(column)
    }

    /// The column in type `wanted`. Only `accepted` types are converted: text that looks like numbers means another
    /// table, or a broken one.
    fn converted(
        &self,
        name: &str,
        wanted: &DataType,
        expected: &str,
        accepted: impl Fn(&DataType) -> bool,
    ) -> Result<ArrayRef, Malformed> {
        let column = self.batch.column_by_name(name).ok_or_else(|| format!("no column {name}"))?;
        let found = match column.data_type() {
            DataType::Dictionary(_, values) => values,
            plain => plain,
        };
        if !accepted(found) {
            let found = if is_string(found) { "text".to_owned() } else { column.data_type().to_string() };
            return Err(format!("column {name} is of type {found}, expected {expected}").into());
        }
        // Views share texts; only here does every row get a copy.
        if let Some(views) = column.as_string_view_opt() {
            let n_bytes: usize = views.iter().flatten().map(str::len).sum();
            if n_bytes > self.max_text_bytes {
                let (n_mib, most) = (n_bytes >> 20, self.max_text_bytes >> 20);
                return Err(format!("column {name} has {n_mib} MiB of text, expected at most {most}").into());
            }
        }
        cast(column, wanted).map_err(|error| format!("column {name}: {error}").into())
    }
}

fn without_null(name: &str, column: &dyn Array) -> Result<(), Malformed> {
    match (0..column.len()).find(|row| column.is_null(*row)) {
        Some(row) => Err(format!("column {name} has no value in row {row}").into()),
        None => Ok(()),
    }
}

const fn is_string(found: &DataType) -> bool {
    matches!(found, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
}

fn lost(name: &str) -> Malformed {
    format!("column {name} cannot be converted").into()
}

/// The schema in which the columns with these `names` are decoded: texts as views, so that rows share a long text.
/// Rejects columns that are neither numbers nor text.
fn views(schema: &Schema, names: &[&str]) -> Result<SchemaRef, Malformed> {
    let in_view = |field: &FieldRef| -> Result<FieldRef, Malformed> {
        let found = match field.data_type() {
            DataType::Dictionary(_, values) => values,
            plain => plain,
        };
        if is_string(found) {
            return Ok(Arc::new(field.as_ref().clone().with_data_type(DataType::Utf8View)));
        }
        if names.contains(&field.name().as_str()) && !found.is_numeric() && *found != DataType::Boolean {
            let (name, found) = (field.name(), field.data_type());
            return Err(format!("column {name} is of type {found}, expected numbers or text").into());
        }
        Ok(Arc::clone(field))
    };
    let fields = schema.fields().iter().map(in_view).collect::<Result<Fields, Malformed>>()?;
    Ok(Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone())))
}

fn decode(
    bytes: &[u8],
    names: &[&str],
    numbers: &[&str],
    limits: Limits,
) -> Result<(RecordBatch, Vec<String>), Malformed> {
    let metadata = read_footer(bytes, bytes.len() as u64)?.ok_or("the file is cut short")?;
    let n_rows = metadata.file_metadata().num_rows();
    if !(0..=limits.n_rows as i64).contains(&n_rows) {
        return Err(format!("{n_rows} rows, expected at most {}", limits.n_rows).into());
    }
    let schema = schema_of(&metadata)?;
    let is_number = |name: &&&str| schema.field_with_name(name).is_ok_and(|field| field.data_type().is_numeric());
    let names: Vec<&str> = names.iter().chain(numbers.iter().filter(is_number)).copied().collect();
    let columns = metadata.row_groups().iter().flat_map(|group| group.columns());
    let wanted = columns.filter(|column| names.contains(&column.column_path().string().as_str()));
    let n_bytes: u64 = wanted.map(|column| column.uncompressed_size().unsigned_abs()).fold(0, u64::saturating_add);
    if n_bytes > limits.n_bytes as u64 {
        return Err(format!("its columns have {} MiB, expected at most {}", n_bytes >> 20, limits.n_bytes >> 20).into());
    }
    let mut decoder = decoder(&Arc::new(metadata), &names, limits.n_rows)?;
    decoder.push_range(0..bytes.len() as u64, bytes.to_vec().into())?;
    let mut batches = Vec::new();
    loop {
        match decoder.try_decode()? {
            DecodeResult::Data(batch) => batches.push(batch),
            DecodeResult::NeedsData(_) => return Err("the file refers to bytes it does not hold".into()),
            DecodeResult::Finished => break,
        }
    }
    let first = batches.first().ok_or("the file has no rows")?;
    Ok((concat_batches(&first.schema(), &batches)?, names_of(&schema)))
}

/// The footer of a file of `n_bytes`, from its last bytes; `None` if more of them are needed.
pub(super) fn read_footer(last: &[u8], n_bytes: u64) -> Result<Option<ParquetMetaData>, Malformed> {
    let mut decoder = ParquetMetaDataPushDecoder::try_new(n_bytes)?.with_page_index_policy(PageIndexPolicy::Skip);
    decoder.push_range(n_bytes.saturating_sub(last.len() as u64)..n_bytes, last.to_vec().into())?;
    let DecodeResult::Data(metadata) = decoder.try_decode()? else { return Ok(None) };
    Ok(Some(metadata))
}

fn schema_of(metadata: &ParquetMetaData) -> Result<Schema, Malformed> {
    let file = metadata.file_metadata();
    Ok(parquet_to_arrow_schema(file.schema_descr(), file.key_value_metadata())?)
}

/// The names of all columns of a file with this footer.
pub(super) fn columns_of(footer: &ParquetMetaData) -> Result<Vec<String>, Malformed> {
    Ok(names_of(&schema_of(footer)?))
}

fn names_of(schema: &Schema) -> Vec<String> {
    schema.fields().iter().map(|field| field.name().clone()).collect()
}

fn decoder(
    metadata: &Arc<ParquetMetaData>,
    names: &[&str],
    n_rows_at_a_time: usize,
) -> Result<ParquetPushDecoder, Malformed> {
    let options = ArrowReaderOptions::new().with_schema(views(&schema_of(metadata)?, names)?);
    let mask = ProjectionMask::columns(metadata.file_metadata().schema_descr(), names.iter().copied());
    Ok(ParquetPushDecoderBuilder::try_new_decoder_with_options(Arc::clone(metadata), options)
        .and_then(|builder| builder.with_projection(mask).with_batch_size(n_rows_at_a_time).build())?)
}

/// Rows that a [`Stream`] decodes at a time.
const N_ROWS_AT_A_TIME: usize = 8192;
/// The most bytes of a column that a [`Stream`] holds, compressed.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// Some columns of a file that arrives as a stream, some rows at a time. Memory is that of a row group, compressed.
pub(super) struct Stream<'r> {
    file: &'r mut dyn BufRead,
    n_bytes_read: u64,
    decoder: ParquetPushDecoder,
    names: Vec<String>,
}

impl<'r> Stream<'r> {
    /// The columns with these `names` of a file with this footer, read from its beginning.
    pub(super) fn of(
        file: &'r mut dyn BufRead,
        metadata: &Arc<ParquetMetaData>,
        names: &[&str],
    ) -> Result<Self, Malformed> {
        let decoder = decoder(metadata, names, N_ROWS_AT_A_TIME)?;
        Ok(Self { file, n_bytes_read: 0, decoder, names: names_of(&schema_of(metadata)?) })
    }

    /// The names of all columns of the file.
    pub(super) fn names(&self) -> &[String] {
        &self.names
    }

    /// The next rows; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Columns>, Malformed> {
        loop {
            let damaged = || Err("the file is damaged beyond decoding".into());
            let decoder = &mut self.decoder;
            let decoded = contained(|| decoder.try_decode().map_err(Malformed::from)).unwrap_or_else(damaged)?;
            match decoded {
                DecodeResult::Finished => return Ok(None),
                DecodeResult::Data(batch) => {
                    return Ok(Some(Columns {
                        batch,
                        names: self.names.clone(),
                        max_text_bytes: MAX_CHUNK_BYTES as usize,
                    }));
                }
                DecodeResult::NeedsData(mut ranges) => {
                    ranges.sort_by_key(|range| range.start);
                    for range in ranges {
                        let bytes = self.bytes(&range)?;
                        self.decoder.push_range(range, bytes.into())?;
                    }
                }
            }
        }
    }

    /// These bytes of the file, which come after all that were read.
    fn bytes(&mut self, range: &Range<u64>) -> Result<Vec<u8>, Malformed> {
        let n_bytes = range.end.saturating_sub(range.start);
        let n_between = range.start.checked_sub(self.n_bytes_read).ok_or("its columns are not one after the other")?;
        if n_bytes > MAX_CHUNK_BYTES {
            return Err(format!("a column has {} MiB in a row group", n_bytes >> 20).into());
        }
        let mut bytes = Vec::new();
        let n_skipped = std::io::copy(&mut Read::take(&mut *self.file, n_between), &mut std::io::sink());
        let n_read = Read::take(&mut *self.file, n_bytes).read_to_end(&mut bytes);
        if !n_skipped.is_ok_and(|n| n == n_between) || !n_read.is_ok_and(|n| n as u64 == n_bytes) {
            return Err("the file is cut short".into());
        }
        self.n_bytes_read = range.end;
        Ok(bytes)
    }
}
