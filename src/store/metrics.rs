//! `metrics.parquet`: the values of metrics, one a row.

use super::tables::metric;
use super::{MetricRow, Result, parquet_file};
use crate::files::FileStamp;
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
        write_metrics(&path, &rows).unwrap();
        assert_eq!(read_metrics(&path).unwrap(), rows);
    }
}
