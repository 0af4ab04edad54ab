//! `metrics.parquet`: one metric value a row.

use super::row_file::{self, ROWS_PER_BATCH, RowFile};
use super::tables::metric;
use super::{Result, remove_if_present};
use crate::files::FileStamp;
use crate::metrics::MetricRow;
use arrow::array::RecordBatch;
use std::path::{Path, PathBuf};

/// Writes a metric table, in the order given.
///
/// # Errors
/// Those of the file system.
pub fn write_metrics(path: &Path, rows: impl IntoIterator<Item = Result<MetricRow>>) -> Result<FileStamp> {
    let mut file = RowFile::create(path, &metric::schema(), metric::encode)?;
    rows.into_iter().try_for_each(|row| file.push(row?))?;
    file.finish()
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

/// Reads a metric table row by row, in the order it was written; few rows are in memory at a time.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or a row is damaged; those of the file system.
pub fn read_metrics(path: &Path) -> Result<impl Iterator<Item = Result<MetricRow>> + use<>> {
    row_file::read(path, &metric::schema(), metric::decode)
}

/// Rows of a batch, and bytes of a row group, that a spool holds in memory: there is a spool for each series.
const ROWS_PER_SPOOLED_BATCH: usize = 1024;
const BYTES_PER_SPOOLED_GROUP: usize = 512 << 10;

/// Metric values in a temporary file, until the rows before them in the table are known.
pub struct MetricSpool {
    path: PathBuf,
    file: RowFile<MetricRow>,
}

impl MetricSpool {
    /// Begins the file.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn create(path: &Path) -> Result<Self> {
        let file = RowFile::create(path, &metric::schema(), metric::encode)?.in_batches_of(ROWS_PER_SPOOLED_BATCH);
        Ok(Self { path: path.to_owned(), file })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn push(&mut self, row: MetricRow) -> Result<()> {
        self.file.push(row)?;
        self.file.limit_memory(BYTES_PER_SPOOLED_GROUP)
    }

    /// Ends the file, so that it can be read.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn finish(self) -> Result<SpooledMetrics> {
        self.file.finish()?;
        Ok(SpooledMetrics { path: self.path })
    }
}

/// A finished spool.
#[derive(Debug)]
pub struct SpooledMetrics {
    path: PathBuf,
}

impl SpooledMetrics {
    /// The rows, in the order in which they were added. They can be read more than once.
    ///
    /// # Errors
    /// As [`read_metrics`].
    pub fn rows(&self) -> Result<impl Iterator<Item = Result<MetricRow>> + use<>> {
        read_metrics(&self.path)
    }

    /// Removes the file.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn remove(self) -> Result<()> {
        Ok(remove_if_present(&self.path)?)
    }
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

    #[test]
    fn a_spool_gives_back_its_rows_in_order_and_leaves_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("metrics.spool");
        // Some groups, and a batch that is not full.
        let n_rows = 64 * ROWS_PER_SPOOLED_BATCH as u64 + 500;
        let row = |n: u64| MetricRow {
            group: Group::Unguided,
            sweep: "s".to_owned(),
            level: GuidanceLevel::UNGUIDED,
            place: "X".to_owned(),
            scene_id: Some(SceneId::from("a/b/c/d")),
            scenario_id: None,
            metric: "mfd_m".to_owned(),
            value: 0.5 * n as f64,
            n,
            std_error: None,
        };
        let mut spool = MetricSpool::create(&path).unwrap();
        (0..n_rows).try_for_each(|n| spool.push(row(n))).unwrap();
        let spooled = spool.finish().unwrap();
        for _ in 0..2 {
            let read = spooled.rows().unwrap().zip(0..n_rows + 1);
            assert_eq!(read.filter(|(read, n)| *read.as_ref().unwrap() == row(*n)).count() as u64, n_rows);
        }
        spooled.remove().unwrap();
        assert_eq!(
            std::fs::read_dir(dir.path()).unwrap().filter(|file| file.as_ref().unwrap().path() == path).count(),
            0
        );
    }
}
