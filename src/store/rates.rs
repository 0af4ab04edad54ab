//! `exposure.parquet` and `rates.parquet`: how much was recorded, and how often something happened in it.

use super::Result;
use super::events::stream_events;
use super::row_file;
use super::tables::{exposure, rate};
use crate::files::FileStamp;
use crate::rates::{ExposureRow, RateRow, RecordedTraffic};
use std::path::Path;

/// Writes a table of exposure.
pub fn write_exposure(path: &Path, rows: Vec<ExposureRow>) -> Result<FileStamp> {
    row_file::write(path, &exposure::schema(), exposure::encode, rows.into_iter().map(Ok))
}

/// Writes a table of rates.
pub fn write_rates(path: &Path, rows: Vec<RateRow>) -> Result<FileStamp> {
    row_file::write(path, &rate::schema(), rate::encode, rows.into_iter().map(Ok))
}

/// Reads a table of rates.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or a row is damaged; errors of the file system.
pub fn read_rates(path: &Path) -> Result<Vec<RateRow>> {
    row_file::read(path, &rate::schema(), rate::decode)?.collect()
}

/// Reads a table of exposure.
///
/// # Errors
/// See [`read_rates`].
pub fn read_exposure(path: &Path) -> Result<Vec<ExposureRow>> {
    row_file::read(path, &exposure::schema(), exposure::decode)?.collect()
}

/// Reads what was counted: exposure, and a table of events in which each is once.
///
/// # Errors
/// See [`read_rates`].
pub fn read_recorded_traffic(exposure: &Path, occurrences: &Path) -> Result<RecordedTraffic> {
    let mut traffic = RecordedTraffic::new(read_exposure(exposure)?);
    for event in stream_events(occurrences)? {
        traffic.add(&event?);
    }
    Ok(traffic)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rates::{CLASSES, RateMethod};
    use crate::scene::{Dataset, Split};
    use crate::statistics::Interval;

    #[test]
    fn rows_come_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.parquet");
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
        let linked = ExposureRow { shares_with: Some("x".to_owned()), ..exposure.clone() };
        let rows = vec![exposure, linked];
        write_exposure(&path, rows.clone()).unwrap();
        assert_eq!(read_exposure(&path).unwrap(), rows);
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
        let rows = vec![rate, without];
        write_rates(&path, rows.clone()).unwrap();
        assert_eq!(read_rates(&path).unwrap(), rows);
    }
}
