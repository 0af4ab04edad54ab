//! The columns of a Parquet file, in any encoding.

use super::error::Malformed;
use crate::containment::contained;
use arrow::array::{Array, ArrayRef, AsArray, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow::compute::{cast, concat_batches};
use arrow::datatypes::{DataType, FieldRef, Fields, Float64Type, Schema, SchemaRef, TimeUnit};
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
    max_text_bytes: usize,
}

impl Columns {
    /// Decodes the columns of a Parquet file with these `names`; those in `numbers` must be numbers.
    pub(super) fn read(bytes: &[u8], names: &[&str], numbers: &[&str], limits: Limits) -> Result<Self, Malformed> {
        let damaged = || Err("the file is damaged beyond decoding".into());
        let batch = contained(|| decode(bytes, names, numbers, limits)).unwrap_or_else(damaged)?;
        Ok(Self { batch, max_text_bytes: limits.n_bytes })
    }

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
        let is_number = |found: &DataType| found.is_numeric() || seconds_in(found).is_some();
        let column = self.converted(name, &DataType::Float64, "numbers", is_number)?;
        let numbers: Float64Array = column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))?;
        Ok(numbers.iter().map(|number| number.unwrap_or(f64::NAN)).collect())
    }

    /// A column of text or numbers, which can be names, too, whole ones without a point; some may be missing.
    pub(super) fn text_or_null(&self, name: &str) -> Result<StringArray, Malformed> {
        let column = self.batch.column_by_name(name).ok_or_else(|| format!("no column {name}"))?;
        let found = values_of(column.data_type());
        if found.is_floating() || found.is_decimal() {
            let text = |number: f64| (!number.is_nan()).then(|| number.to_string());
            return Ok(self.float_or_nan(name)?.into_iter().map(text).collect());
        }
        let is_text = |found: &DataType| is_string(found) || found.is_integer();
        let column = self.converted(name, &DataType::Utf8, "text", is_text)?;
        column.as_any().downcast_ref().cloned().ok_or_else(|| lost(name))
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
        let found = values_of(column.data_type());
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
        let cast = |column: &ArrayRef, wanted: &DataType| {
            cast(column, wanted).map_err(|error| Malformed::from(format!("column {name}: {error}")))
        };
        let Some(unit_s) = seconds_in(found) else { return cast(column, wanted) };
        // Times are counted in a unit of their own.
        let counts = cast(&cast(&cast(column, found)?, &DataType::Int64)?, &DataType::Float64)?;
        let counts: &Float64Array = counts.as_any().downcast_ref().ok_or_else(|| lost(name))?;
        cast(&(Arc::new(counts.unary::<_, Float64Type>(|count| count / unit_s)) as ArrayRef), wanted)
    }
}

fn without_null(name: &str, column: &dyn Array) -> Result<(), Malformed> {
    match (0..column.len()).find(|row| column.is_null(*row)) {
        Some(row) => Err(format!("column {name} has no value in row {row}").into()),
        None => Ok(()),
    }
}

fn values_of(found: &DataType) -> &DataType {
    match found {
        DataType::Dictionary(_, values) => values,
        plain => plain,
    }
}

/// Units of a time in a second, if the type is one of times or durations.
const fn seconds_in(found: &DataType) -> Option<f64> {
    match found {
        DataType::Timestamp(unit, _) | DataType::Duration(unit) => Some(match unit {
            TimeUnit::Second => 1.0,
            TimeUnit::Millisecond => 1e3,
            TimeUnit::Microsecond => 1e6,
            TimeUnit::Nanosecond => 1e9,
        }),
        _ => None,
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
        let found = values_of(field.data_type());
        if is_string(found) {
            return Ok(Arc::new(field.as_ref().clone().with_data_type(DataType::Utf8View)));
        }
        let is_read = found.is_numeric() || seconds_in(found).is_some() || *found == DataType::Boolean;
        if names.contains(&field.name().as_str()) && !is_read {
            let (name, found) = (field.name(), field.data_type());
            return Err(format!("column {name} is of type {found}, expected numbers or text").into());
        }
        Ok(Arc::clone(field))
    };
    let fields = schema.fields().iter().map(in_view).collect::<Result<Fields, Malformed>>()?;
    Ok(Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone())))
}

fn decode(bytes: &[u8], names: &[&str], numbers: &[&str], limits: Limits) -> Result<RecordBatch, Malformed> {
    let metadata = read_footer(bytes, bytes.len() as u64)?.ok_or("the file is cut short")?;
    let n_rows = metadata.file_metadata().num_rows();
    if !(0..=limits.n_rows as i64).contains(&n_rows) {
        return Err(format!("{n_rows} rows, expected at most {}", limits.n_rows).into());
    }
    let schema = schema_of(&metadata)?;
    let is_number = |name: &&&str| schema.field_with_name(name).is_ok_and(|field| field.data_type().is_numeric());
    let names: Vec<&str> = names.iter().chain(numbers.iter().filter(is_number)).copied().collect();
    let n_bytes = n_bytes_of(&metadata, &names);
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
    Ok(concat_batches(&first.schema(), &batches)?)
}

/// The footer of a file of `n_bytes`, from its last bytes; `None` if more of them are needed.
pub(super) fn read_footer(last: &[u8], n_bytes: u64) -> Result<Option<ParquetMetaData>, Malformed> {
    let mut decoder = ParquetMetaDataPushDecoder::try_new(n_bytes)?.with_page_index_policy(PageIndexPolicy::Skip);
    decoder.push_range(n_bytes.saturating_sub(last.len() as u64)..n_bytes, last.to_vec().into())?;
    let DecodeResult::Data(metadata) = decoder.try_decode()? else { return Ok(None) };
    Ok(Some(metadata))
}

/// The uncompressed size of the columns with these `names`, bytes.
pub(super) fn n_bytes_of(metadata: &ParquetMetaData, names: &[&str]) -> u64 {
    chunks(metadata, names).map(|(_, n_bytes)| n_bytes).fold(0, u64::saturating_add)
}

/// The columns with these `names` in each row group, with their uncompressed sizes in bytes.
fn chunks(metadata: &ParquetMetaData, names: &[&str]) -> impl Iterator<Item = (String, u64)> {
    let columns = metadata.row_groups().iter().flat_map(|group| group.columns());
    let sized = columns.map(|column| (column.column_path().string(), column.uncompressed_size().unsigned_abs()));
    sized.filter(|(name, _)| names.contains(&name.as_str()))
}

fn schema_of(metadata: &ParquetMetaData) -> Result<Schema, Malformed> {
    let file = metadata.file_metadata();
    Ok(parquet_to_arrow_schema(file.schema_descr(), file.key_value_metadata())?)
}

/// The names of all columns of a file with this footer.
pub(super) fn columns_of(footer: &ParquetMetaData) -> Result<Vec<String>, Malformed> {
    Ok(schema_of(footer)?.fields().iter().map(|field| field.name().clone()).collect())
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
/// The most bytes of a column in a row group of a [`Stream`], compressed or not, as a page may be all of it.
const MAX_CHUNK_BYTES: u64 = 1 << 29;
/// The most bytes of text in a column of the rows that a [`Stream`] decodes at a time.
const MAX_TEXT_BYTES: usize = 64 << 20;

/// Some columns of a file that arrives as a stream, some rows at a time. Memory is that of a row group, compressed.
pub(super) struct Stream<'r> {
    file: &'r mut dyn BufRead,
    n_bytes_read: u64,
    decoder: ParquetPushDecoder,
}

impl<'r> Stream<'r> {
    /// The columns with these `names` of a file with this footer, read from its beginning.
    pub(super) fn of(
        file: &'r mut dyn BufRead,
        metadata: &Arc<ParquetMetaData>,
        names: &[&str],
    ) -> Result<Self, Malformed> {
        if let Some((name, n_bytes)) = chunks(metadata, names).find(|(_, n_bytes)| *n_bytes > MAX_CHUNK_BYTES) {
            let (n_mib, most) = (n_bytes >> 20, MAX_CHUNK_BYTES >> 20);
            return Err(format!("column {name} has {n_mib} MiB in a row group, expected at most {most}").into());
        }
        let decoder = decoder(metadata, names, N_ROWS_AT_A_TIME)?;
        Ok(Self { file, n_bytes_read: 0, decoder })
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
                    return Ok(Some(Columns { batch, max_text_bytes: MAX_TEXT_BYTES }));
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
