//! One Parquet file of ours: how are tables written so that equal content gives equal bytes, and read so that a wrong file is named?

use super::atomic::{AtomicFile, FileStamp};
use super::schema::{SCHEMA_KEY, TableSchema};
use super::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use fs_err as fs;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::{ParquetRecordBatchReaderBuilder, RowSelection, RowSelector};
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Rows of a row group: what a writer holds in memory, and what a reader can skip.
const ROWS_PER_GROUP: usize = 128 * 1024;

/// Writes one table, batch by batch, holding at most a row group in memory.
pub(crate) struct ParquetFile {
    path: PathBuf,
    writer: ArrowWriter<AtomicFile>,
    n_rows: u64,
}

impl ParquetFile {
    /// Begins a file of this table; `schema` is the table's with its open columns.
    pub(crate) fn create(path: &Path, table: &TableSchema, schema: SchemaRef) -> Result<Self> {
        let level = ZstdLevel::try_new(3).map_err(Error::parquet(path))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(level))
            // The default names the version of the library: an update would change every file.
            .set_created_by("djinn".to_owned())
            .set_max_row_group_row_count(Some(ROWS_PER_GROUP))
            .set_key_value_metadata(Some(vec![KeyValue::new(SCHEMA_KEY.to_owned(), table.id())]))
            .build();
        let file = AtomicFile::create(path)?;
        let writer = ArrowWriter::try_new(file, schema, Some(properties)).map_err(Error::parquet(path))?;
        Ok(Self { path: path.to_owned(), writer, n_rows: 0 })
    }

    /// Adds rows.
    pub(crate) fn write(&mut self, batch: &RecordBatch) -> Result<()> {
        self.n_rows += batch.num_rows() as u64;
        self.writer.write(batch).map_err(Error::parquet(&self.path))
    }

    /// Number of rows so far.
    pub(crate) const fn n_rows(&self) -> u64 {
        self.n_rows
    }

    /// Writes the footer and gives the file its name.
    pub(crate) fn finish(self) -> Result<FileStamp> {
        let file = self.writer.into_inner().map_err(Error::parquet(&self.path))?;
        Ok(file.commit()?)
    }
}

/// Writes a table that is one batch.
pub(crate) fn write_batch(path: &Path, table: &TableSchema, batch: &RecordBatch) -> Result<FileStamp> {
    let mut file = ParquetFile::create(path, table, batch.schema())?;
    file.write(batch)?;
    file.finish()
}

/// Reads all rows of a table.
pub(crate) fn read(path: &Path, table: &TableSchema) -> Result<Vec<RecordBatch>> {
    collect(path, open(path, table)?)
}

/// Reads a range of the rows of a table, skipping the others.
pub(crate) fn read_rows(path: &Path, table: &TableSchema, rows: Range<usize>) -> Result<Vec<RecordBatch>> {
    let selection = RowSelection::from(vec![RowSelector::skip(rows.start), RowSelector::select(rows.len())]);
    let reader = open(path, table)?.with_row_selection(selection).with_batch_size(rows.len().max(1));
    collect(path, reader)
}

type Reader = ParquetRecordBatchReaderBuilder<std::fs::File>;

fn open(path: &Path, table: &TableSchema) -> Result<Reader> {
    // Parquet reads files of the standard library only; the errors of opening still name the path.
    let (file, _) = fs::File::open(path)?.into_parts();
    let reader = Reader::try_new(file).map_err(damaged(path))?;
    table.check(path, reader.schema())?;
    Ok(reader)
}

fn collect(path: &Path, reader: Reader) -> Result<Vec<RecordBatch>> {
    let batches = reader.build().map_err(damaged(path))?;
    batches.map(|batch| batch.map_err(|error| Error::corrupt(path, error.to_string()))).collect()
}

/// A file that Parquet cannot read was not written by us, or is not whole.
fn damaged(path: &Path) -> impl FnOnce(parquet::errors::ParquetError) -> Error {
    let path = path.to_owned();
    move |error| Error::corrupt(&path, error.to_string())
}
