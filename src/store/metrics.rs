//! `metrics.parquet`: the values of metrics, one a row.

use super::atomic::FileStamp;
use super::tables::metric;
use super::{MetricRow, Result, parquet_file};
use std::path::Path;

/// Writes a metric table, in the order given.
///
/// # Errors
/// Those of the file system.
pub fn write_metrics(path: &Path, rows: &[MetricRow]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &metric::schema(), &metric::encode(rows)?)
}

/// Reads a metric table, in the order it was written.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is no
/// such table; those of the file system.
pub fn read_metrics(path: &Path) -> Result<Vec<MetricRow>> {
    let mut rows = Vec::new();
    for batch in parquet_file::read(path, &metric::schema())? {
        rows.extend(metric::decode(&batch, path)?);
    }
    Ok(rows)
}
