//! One Parquet file of ours: written so that equal content gives equal bytes, and read with errors that name the file.

use super::schema::{SCHEMA_KEY, TableSchema};
use super::{Error, Result};
use crate::containment;
use crate::files::{AtomicFile, FileStamp};
use arrow::array::RecordBatch;
use arrow::datatypes::{Schema, SchemaRef};
use fs_err as fs;
use parquet::arrow::arrow_reader::{
    ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder, RowSelection, RowSelector,
};
use parquet::arrow::{ArrowSchemaConverter, ArrowWriter, ProjectionMask};
use parquet::basic::{Compression, Encoding, Type, ZstdLevel};
use parquet::file::metadata::{KeyValue, PageIndexPolicy};
use parquet::file::properties::WriterProperties;
use parquet::file::reader::ChunkReader;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows of a row group: the unit that a writer holds in memory and a reader can skip.
const ROWS_PER_GROUP: usize = 128 * 1024;
/// Encoded bytes at which a row group ends early: a row of the scenario table takes almost a kilobyte.
const BYTES_PER_GROUP: usize = 4 << 20;

/// Writes one table, batch by batch, holding at most a row group in memory. Row groups depend only on the batches.
pub(crate) struct ParquetFile {
    path: PathBuf,
    writer: ArrowWriter<AtomicFile>,
    n_rows: u64,
}

impl ParquetFile {
    /// Begins a file of this table; `schema` is the table's, with its open columns.
    pub(crate) fn create(path: &Path, table: &TableSchema, schema: SchemaRef) -> Result<Self> {
        let properties = properties(table, &schema).map_err(Error::parquet(path))?;
        let file = AtomicFile::create(path)?;
        let writer = ArrowWriter::try_new(file, schema, Some(properties)).map_err(Error::parquet(path))?;
        Ok(Self { path: path.to_owned(), writer, n_rows: 0 })
    }

    /// Adds rows.
    pub(crate) fn write(&mut self, batch: &RecordBatch) -> Result<()> {
        self.n_rows += batch.num_rows() as u64;
        self.writer.write(batch).map_err(Error::parquet(&self.path))?;
        if self.n_bytes_in_memory() > BYTES_PER_GROUP { self.flush() } else { Ok(()) }
    }

    /// Number of rows so far.
    pub(crate) const fn n_rows(&self) -> u64 {
        self.n_rows
    }

    /// Encoded bytes of the unfinished row group, which is in memory.
    pub(crate) fn n_bytes_in_memory(&self) -> usize {
        self.writer.memory_size()
    }

    /// Ends the row group early and frees its memory.
    pub(crate) fn flush(&mut self) -> Result<()> {
        self.writer.flush().map_err(Error::parquet(&self.path))
    }

    /// Writes the footer and gives the file its name.
    pub(crate) fn finish(self) -> Result<FileStamp> {
        let file = self.writer.into_inner().map_err(Error::parquet(&self.path))?;
        Ok(file.commit()?)
    }
}

fn properties(table: &TableSchema, schema: &Schema) -> parquet::errors::Result<WriterProperties> {
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(3)?))
        // The default names the version of the library, so that an update would change every file.
        .set_created_by("djinn".to_owned())
        .set_max_row_group_row_count(Some(ROWS_PER_GROUP))
        .set_key_value_metadata(Some(vec![KeyValue::new(SCHEMA_KEY.to_owned(), table.id())]));
    for column in ArrowSchemaConverter::new().convert(schema)?.columns() {
        // Measured numbers rarely repeat, so a dictionary would make the column larger.
        if matches!(column.physical_type(), Type::FLOAT | Type::DOUBLE) {
            properties = properties.set_column_dictionary_enabled(column.path().clone(), false);
            // Bytes grouped by significance compress better by a seventh (measured on tracks).
            properties = properties.set_column_encoding(column.path().clone(), Encoding::BYTE_STREAM_SPLIT);
        }
    }
    Ok(properties.build())
}

pub(crate) fn write_batch(path: &Path, table: &TableSchema, batch: &RecordBatch) -> Result<FileStamp> {
    let mut file = ParquetFile::create(path, table, batch.schema())?;
    file.write(batch)?;
    file.finish()
}

pub(crate) fn read(path: &Path, table: &TableSchema) -> Result<Vec<RecordBatch>> {
    stream(path, table, None)?.collect()
}

/// Reads a range of the rows of a table, and only the pages that hold them.
pub(crate) fn read_rows(path: &Path, table: &TableSchema, rows: Range<usize>) -> Result<Vec<RecordBatch>> {
    let selection = RowSelection::from(vec![RowSelector::skip(rows.start), RowSelector::select(rows.len())]);
    let options = ArrowReaderOptions::new().with_offset_index_policy(PageIndexPolicy::Optional);
    let reader = contained(path, || {
        let reader = open(path, table, options)?.with_row_selection(selection).with_batch_size(rows.len().max(1));
        reader.build().map_err(damaged(path))
    })?;
    Batches { path: path.to_owned(), table: table.clone(), is_whole: true, reader: Some(reader) }.collect()
}

/// Rows that a streaming reader holds at a time.
const ROWS_PER_BATCH: usize = 8 * 1024;

/// Reads a table batch by batch: whole rows in the current version of the table, or only some columns unchanged.
pub(crate) fn stream(path: &Path, table: &TableSchema, columns: Option<&[&str]>) -> Result<Batches> {
    let reader = contained(path, || {
        let reader = open(path, table, ArrowReaderOptions::new())?.with_batch_size(ROWS_PER_BATCH);
        let reader = match columns {
            Some(columns) => {
                let mask = ProjectionMask::columns(reader.parquet_schema(), columns.iter().copied());
                reader.with_projection(mask)
            }
            None => reader,
        };
        reader.build().map_err(damaged(path))
    })?;
    Ok(Batches { path: path.to_owned(), table: table.clone(), is_whole: columns.is_none(), reader: Some(reader) })
}

/// The columns of a table's file, read from its footer.
pub(crate) fn schema(path: &Path, table: &TableSchema) -> Result<SchemaRef> {
    contained(path, || Ok(Arc::clone(open(path, table, ArrowReaderOptions::new())?.schema())))
}

/// The number of rows of a table's file, read from its footer.
pub(crate) fn n_rows(path: &Path, table: &TableSchema) -> Result<u64> {
    let reader = |table| open(path, table, ArrowReaderOptions::new());
    contained(path, || Ok(reader(table)?.metadata().file_metadata().num_rows().unsigned_abs()))
}

/// The batches of a file, which end after the first error.
pub(crate) struct Batches {
    path: PathBuf,
    table: TableSchema,
    /// Whether all columns are read, so that batches can get the current descriptions of columns.
    is_whole: bool,
    reader: Option<ParquetRecordBatchReader>,
}

impl Iterator for Batches {
    type Item = Result<RecordBatch>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut reader = self.reader.take()?;
        let batch = contained(&self.path, || Ok(reader.next()));
        let batch = match batch {
            Ok(None) => return None,
            Ok(Some(Ok(batch))) if self.is_whole => self.table.conform(&self.path, &batch),
            Ok(Some(Ok(batch))) => Ok(batch),
            Ok(Some(Err(error))) => Err(Error::unreadable(&self.path, error)),
            Err(error) => Err(error),
        };
        if batch.is_ok() {
            self.reader = Some(reader);
        }
        Some(batch)
    }
}

/// Turns panics of the reader, which some damaged files cause, into errors.
pub(super) fn contained<T>(path: &Path, read: impl FnOnce() -> Result<T>) -> Result<T> {
    containment::contained(read).unwrap_or_else(|| Err(Error::corrupt(path, "it cannot be decoded")))
}

fn open(
    path: &Path,
    table: &TableSchema,
    options: ArrowReaderOptions,
) -> Result<ParquetRecordBatchReaderBuilder<impl ChunkReader + 'static>> {
    // Parquet only reads files of the standard library; errors of opening them still name the path.
    let (file, _) = fs::File::open(path)?.into_parts();
    let reader = ParquetRecordBatchReaderBuilder::try_new_with_options(file, options).map_err(damaged(path))?;
    table.check(path, reader.schema())?;
    Ok(reader)
}

/// A file that Parquet cannot read is incomplete or was not written by djinn, unless the system failed.
fn damaged(path: &Path) -> impl FnOnce(parquet::errors::ParquetError) -> Error {
    let path = path.to_owned();
    move |error| Error::unreadable(&path, error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::VerdictRow;
    use crate::scene::GuidanceLevel;
    use crate::store::tables::verdict;

    #[test]
    fn what_a_writer_holds_is_bounded_by_bytes_and_not_by_rows_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (path, table) = (dir.path().join("verdicts.parquet"), verdict::schema());
        // Half a kilobyte that is hardly compressible.
        let id = |n: usize| (0..8).map(move |part| blake3::hash(format!("{n} {part}").as_bytes()).to_hex().to_string());
        let row = |n: usize| VerdictRow {
            scenario_id: id(n).collect(),
            sweep: "s".to_owned(),
            level: GuidanceLevel::UNGUIDED,
            accepted: false,
            kept: false,
            reasons: Vec::new(),
            preventable: None,
            careful_margin_s: None,
            not_checked: Vec::new(),
        };
        let (n_batches, per_batch) = (80, 512);
        let mut file = ParquetFile::create(&path, &table, verdict::encode(&[]).unwrap().schema()).unwrap();
        for batch in 0..n_batches {
            let rows: Vec<VerdictRow> = (batch * per_batch..(batch + 1) * per_batch).map(row).collect();
            file.write(&verdict::encode(&rows).unwrap()).unwrap();
            assert!(file.n_bytes_in_memory() <= BYTES_PER_GROUP, "batch {batch}");
        }
        file.finish().unwrap();
        let n_groups = open(&path, &table, ArrowReaderOptions::new()).unwrap().metadata().num_row_groups();
        assert!((2..10).contains(&n_groups), "{n_groups} row groups");
        assert_eq!(n_rows(&path, &table).unwrap(), (n_batches * per_batch) as u64);
    }
}
