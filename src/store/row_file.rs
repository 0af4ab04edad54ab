//! Tables of plain rows: written and read row by row, with few rows in memory at a time.

use super::parquet_file::{self, ParquetFile};
use super::schema::TableSchema;
use super::{Result, stream_events, tables};
use crate::coverage::{CoverageRow, TaggedScene};
use crate::files::FileStamp;
use crate::metrics::MetricRow;
use crate::rates::{ExposureRow, RateRow, RecordedTraffic};
use crate::scenario::VerdictRow;
use arrow::array::RecordBatch;
use std::path::Path;

/// Rows of a batch; a row takes up to 300 bytes. The pages of a file break at the ends of batches.
pub(super) const ROWS_PER_BATCH: usize = 8 * 1024;

/// A row of one of our tables.
pub trait TableRow: Sized {
    /// Its table.
    fn table() -> TableSchema;
    /// The batch of these rows.
    fn encode(rows: &[Self]) -> Result<RecordBatch>;
    /// The rows of a batch of the table, which was read from `path`.
    fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<Self>>;
}

/// Rows, and the file in `tables` that says what their columns are.
macro_rules! rows_of_tables {
    ($($Row:ty = $table:ident,)*) => {
        $(impl TableRow for $Row {
            fn table() -> TableSchema {
                tables::$table::schema()
            }

            fn encode(rows: &[Self]) -> Result<RecordBatch> {
                tables::$table::encode(rows)
            }

            fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<Self>> {
                tables::$table::decode(batch, path)
            }
        })*
    };
}

rows_of_tables! {
    CoverageRow = coverage,
    ExposureRow = exposure,
    MetricRow = metric,
    RateRow = rate,
    TaggedScene = tag,
    VerdictRow = verdict,
}

/// Writes a table row by row.
pub struct TableWriter<T> {
    file: ParquetFile,
    pending: Vec<T>,
}

impl<T: TableRow> TableWriter<T> {
    /// Begins the table.
    pub fn create(path: &Path) -> Result<Self> {
        let file = ParquetFile::create(path, &T::table(), T::encode(&[])?.schema())?;
        Ok(Self { file, pending: Vec::new() })
    }

    /// Adds a row.
    pub fn push(&mut self, row: T) -> Result<()> {
        self.pending.push(row);
        if self.pending.len() == ROWS_PER_BATCH {
            self.write_pending()?;
        }
        Ok(())
    }

    /// Writes the footer and gives the file its name.
    pub fn finish(mut self) -> Result<FileStamp> {
        if !self.pending.is_empty() {
            self.write_pending()?;
        }
        self.file.finish()
    }

    fn write_pending(&mut self) -> Result<()> {
        self.file.write(&T::encode(&self.pending)?)?;
        self.pending.clear();
        Ok(())
    }
}

/// Writes a table of these rows, in their order.
pub fn write_table<T: TableRow>(path: &Path, rows: impl IntoIterator<Item = Result<T>>) -> Result<FileStamp> {
    let mut writer = TableWriter::create(path)?;
    rows.into_iter().try_for_each(|row| writer.push(row?))?;
    writer.finish()
}

/// Reads a whole table, in the order in which it was written.
pub fn read_table<T: TableRow>(path: &Path) -> Result<Vec<T>> {
    stream_table(path)?.collect()
}

/// Reads a table row by row, in the order in which it was written; the rows end after the first error.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or a row is damaged; errors of the file system.
pub fn stream_table<T: TableRow>(path: &Path) -> Result<impl Iterator<Item = Result<T>> + use<T>> {
    stream(path, &T::table(), T::decode)
}

/// [`stream_table`] with the columns and the decoder of the rows.
pub(super) fn stream<T>(
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

/// Reads what was counted: exposure, and a table of events in which each is once.
pub fn read_recorded_traffic(exposure: &Path, occurrences: &Path) -> Result<RecordedTraffic> {
    let mut traffic = RecordedTraffic::new(read_table(exposure)?);
    for event in stream_events(occurrences)? {
        traffic.add(&event?);
    }
    Ok(traffic)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::Tags;
    use crate::metrics::Group;
    use crate::rates::{CLASSES, RateMethod};
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{Dataset, GuidanceLevel, SceneId, Split};
    use crate::statistics::Interval;
    use std::fmt::Debug;

    #[track_caller]
    fn come_back<T: TableRow + Clone + PartialEq + Debug>(rows: &[T]) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.parquet");
        write_table(&path, rows.iter().cloned().map(Ok)).unwrap();
        assert_eq!(read_table::<T>(&path).unwrap(), rows);
    }

    #[test]
    fn rows_come_back_as_they_were() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0)]);
        let (place, split, tags) = (scene.source.place.clone(), scene.source.split, Tags::of(&scene));
        let [first, second, ..] = tags.each();
        come_back(&[TaggedScene { scene_id: scene.id, place, split, tags, observed_h: 0.25 }]);
        let coverage = CoverageRow {
            tags: [Some(first), Some(second)],
            behavior: "cut_in".to_owned(),
            within: "gap_m 0..5".to_owned(),
            observed_h: 2.0,
            n_recorded: 3,
            rate_per_hour: Some(1.5),
            per_hour: Some(Interval { low: 0.5, high: 4.0 }),
            n_generated: 2,
            n_accepted: 1,
        };
        let anywhere = CoverageRow { tags: [None, None], rate_per_hour: None, per_hour: None, ..coverage.clone() };
        come_back(&[coverage, anywhere]);
        let exposure = ExposureRow {
            dataset: Dataset::Interaction,
            place: "A".to_owned(),
            split: Split::Train,
            recording: "interaction/train/A/000".to_owned(),
            shares_with: None,
            n_scenes: 3,
            observed_h: 0.1,
            class_h: std::array::from_fn(|i| i as f64),
            class_km: [0.25; CLASSES.len()],
        };
        come_back(&[exposure.clone(), ExposureRow { shares_with: Some("x".to_owned()), ..exposure }]);
        let rate = RateRow {
            place: String::new(),
            split: "train".to_owned(),
            behavior: "cut_in".to_owned(),
            within: "gap_m 0..5".to_owned(),
            n_events: 2,
            n_recordings: 1,
            observed_h: 0.5,
            motorized_km: 20.0,
            rate_per_hour: 4.0,
            per_hour: Interval { low: 1.0, high: 9.0 },
            rate_per_1000_km: Some(100.0),
            per_1000_km: Some(Interval { low: 25.0, high: 225.0 }),
            dispersion: Some(1.5),
            method: RateMethod::OneRecording,
            note: Some("x".to_owned()),
        };
        let without =
            RateRow { rate_per_1000_km: None, per_1000_km: None, dispersion: None, note: None, ..rate.clone() };
        come_back(&[rate, without]);
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
        let (scene_id, scenario_id) = (Some(SceneId::from("a/b/c/d")), Some("s".to_owned()));
        come_back(&[aggregate.clone(), MetricRow { scene_id, scenario_id, std_error: None, ..aggregate }]);
        let verdict = |id: &str, reasons: &[&str]| VerdictRow {
            scenario_id: id.to_owned(),
            sweep: "cut_ins".to_owned(),
            level: GuidanceLevel::of_strength(2.0),
            accepted: reasons.is_empty(),
            kept: reasons.len() < 2,
            reasons: reasons.iter().map(|reason| (*reason).to_owned()).collect(),
            preventable: (id == "b").then_some(false),
            careful_margin_s: (id == "b").then_some(-0.25),
            not_checked: if id == "b" { vec!["offroad".to_owned()] } else { Vec::new() },
        };
        come_back(&[verdict("a", &["not_verified", "jerk"]), verdict("b", &[]), verdict("c", &["near_duplicate"])]);
    }
}
