//! Writes and reads a table row by row, with few rows in memory at a time.

use super::Result;
use super::parquet_file::{self, ParquetFile};
use super::schema::TableSchema;
use crate::files::FileStamp;
use arrow::array::RecordBatch;
use std::path::Path;

/// Rows of a batch; a row takes up to 300 bytes. The pages of a file break at the ends of batches.
pub(super) const ROWS_PER_BATCH: usize = 8 * 1024;

/// Writes a table row by row.
pub(super) struct RowFile<T> {
    file: ParquetFile,
    pending: Vec<T>,
    encode: fn(&[T]) -> Result<RecordBatch>,
}

impl<T> RowFile<T> {
    /// Begins a file of this table; `encode` turns rows into batches.
    pub(super) fn create(path: &Path, table: &TableSchema, encode: fn(&[T]) -> Result<RecordBatch>) -> Result<Self> {
        let file = ParquetFile::create(path, table, encode(&[])?.schema())?;
        Ok(Self { file, pending: Vec::new(), encode })
    }

    /// Adds a row.
    pub(super) fn push(&mut self, row: T) -> Result<()> {
        self.pending.push(row);
        if self.pending.len() == ROWS_PER_BATCH {
            self.write_pending()?;
        }
        Ok(())
    }

    /// Writes the footer and gives the file its name.
    pub(super) fn finish(mut self) -> Result<FileStamp> {
        if !self.pending.is_empty() {
            self.write_pending()?;
        }
        self.file.finish()
    }

    fn write_pending(&mut self) -> Result<()> {
        self.file.write(&(self.encode)(&self.pending)?)?;
        self.pending.clear();
        Ok(())
    }
}

/// Writes a table of these rows.
pub(super) fn write<T>(
    path: &Path,
    table: &TableSchema,
    encode: fn(&[T]) -> Result<RecordBatch>,
    rows: impl IntoIterator<Item = Result<T>>,
) -> Result<FileStamp> {
    let mut file = RowFile::create(path, table, encode)?;
    rows.into_iter().try_for_each(|row| file.push(row?))?;
    file.finish()
}

/// Reads a table row by row, in the order in which it was written; the rows end after the first error.
pub(super) fn read<T>(
    path: &Path,
    table: &TableSchema,
    decode: fn(&RecordBatch, &Path) -> Result<Vec<T>>,
) -> Result<impl Iterator<Item = Result<T>> + use<T>> {
    let batches = parquet_file::stream(path, table, None)?;
    let path = path.to_owned();
    Ok(batches.flat_map(move |batch| in_turn(batch.and_then(|batch| decode(&batch, &path)))))
}

fn in_turn<T>(rows: Result<Vec<T>>) -> impl Iterator<Item = Result<T>> {
    let (rows, error) = match rows {
        Ok(rows) => (rows, None),
        Err(error) => (Vec::new(), Some(Err(error))),
    };
    rows.into_iter().map(Ok).chain(error)
}
