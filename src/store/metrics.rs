//! `metrics.parquet`: one metric value a row.

use super::Result;
use super::row_file::{self, ROWS_PER_BATCH};
use super::tables::metric;
use crate::files::FileStamp;
use crate::metrics::MetricRow;
use arrow::array::RecordBatch;
use std::path::Path;

/// Writes a metric table, in the given order.
pub fn write_metrics(path: &Path, rows: impl IntoIterator<Item = Result<MetricRow>>) -> Result<FileStamp> {
    row_file::write(path, &metric::schema(), metric::encode, rows)
}

/// The rows as batches, so that few are in memory at a time.
pub(super) fn batches(rows: impl IntoIterator<Item = Result<MetricRow>>) -> impl Iterator<Item = Result<RecordBatch>> {
    let mut rows = rows.into_iter().peekable();
    std::iter::from_fn(move || {
        rows.peek()?;
        let batch: Result<Vec<MetricRow>> = rows.by_ref().take(ROWS_PER_BATCH).collect();
        Some(batch.and_then(|batch| metric::encode(&batch)))
    })
}

/// Reads a metric table row by row, in the order in which it was written; few rows are in memory at a time.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or a row is damaged; errors of the file system.
pub fn read_metrics(path: &Path) -> Result<impl Iterator<Item = Result<MetricRow>> + use<>> {
    row_file::read(path, &metric::schema(), metric::decode)
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
        write_metrics(&path, rows.clone().map(Ok)).unwrap();
        assert_eq!(read_metrics(&path).unwrap().collect::<Result<Vec<_>>>().unwrap(), rows);
    }
}
