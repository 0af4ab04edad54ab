//! `metrics.parquet`: the values of metrics, one a row.

use super::parquet_file::{self, ParquetFile};
use super::tables::metric;
use super::{MetricRow, Result};
use crate::files::FileStamp;
use arrow::array::RecordBatch;
use std::path::Path;

/// Writes a metric table, in the order given.
///
/// # Errors
/// Those of the file system.
pub fn write_metrics(path: &Path, rows: impl IntoIterator<Item = MetricRow>) -> Result<FileStamp> {
    let mut file = ParquetFile::create(path, &metric::schema(), metric::encode(&[])?.schema())?;
    batches(rows).try_for_each(|batch| file.write(&batch?))?;
    file.finish()
}

/// Rows of a batch. A row takes some 300 bytes.
const ROWS_PER_BATCH: usize = 8 * 1024;

/// The rows as batches, so that few are in memory at a time.
pub(super) fn batches(rows: impl IntoIterator<Item = MetricRow>) -> impl Iterator<Item = Result<RecordBatch>> {
    let mut rows = rows.into_iter().peekable();
    std::iter::from_fn(move || {
        rows.peek()?;
        Some(metric::encode(&rows.by_ref().take(ROWS_PER_BATCH).collect::<Vec<_>>()))
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Group;
    use crate::scene::GuidanceLevel;
    use crate::scene::SceneId;

    #[test]
    fn values_come_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("metrics.parquet");
        let aggregate = MetricRow {
            group: Group::Sweep("guided".to_owned()),
            sweep: "guided".to_owned(),
            level: GuidanceLevel::of_strength(2.0),
            place: String::new(),
            scene_id: None,
            scenario_id: None,
            metric: "collision_rate".to_owned(),
            value: 1.0 / 3.0,
            n: 6,
            std_error: Some(0.1),
        };
        let single = MetricRow {
            scene_id: Some(SceneId::from("a/b/c/d")),
            scenario_id: Some("s".to_owned()),
            std_error: None,
            ..aggregate.clone()
        };
        let rows = [aggregate, single];
        write_metrics(&path, rows.clone()).unwrap();
        assert_eq!(read_metrics(&path).unwrap(), rows);
    }
}
