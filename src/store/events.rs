//! `events.parquet`: what did mining find?

use super::atomic::FileStamp;
use super::tables::event;
use super::{Result, parquet_file};
use crate::behavior::BehaviorEvent;
use std::path::Path;

/// Writes an event table, in the order given.
///
/// # Errors
/// [`Error::Invalid`](super::Error::Invalid) when a parameter has the name of another column; those of the file system.
pub fn write_events(path: &Path, events: &[BehaviorEvent]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &event::schema(), &event::encode(events)?)
}

/// Reads an event table, in the order it was written.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is no
/// such table; those of the file system.
pub fn read_events(path: &Path) -> Result<Vec<BehaviorEvent>> {
    let mut events = Vec::new();
    for batch in parquet_file::read(path, &event::schema())? {
        events.extend(event::decode(&batch, path)?);
    }
    Ok(events)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::EventLabel;
    use crate::scene::{SceneId, TrackId};
    use crate::store::testing::event;
    use crate::store::{Error, MetricRow, write_metrics};

    fn events() -> Vec<BehaviorEvent> {
        let scene = SceneId::from("interaction/val/DR_CHN_Merging_ZS0/7");
        let cut_in = event(&scene, "cut_in", &[("gap_m", 0.1 + 0.2), ("ttc_s", 1.5)]);
        let turn = BehaviorEvent {
            roles: vec![("agent".to_owned(), TrackId::from("9"))],
            label: EventLabel::Negative,
            ..event(&scene, "left_turn", &[("radius_m", 12.0)])
        };
        vec![cut_in.clone(), turn, cut_in]
    }

    #[test]
    fn events_come_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.parquet");
        let stamp = write_events(&path, &events()).unwrap();
        assert_eq!(read_events(&path).unwrap(), events());
        stamp.verify_file(&path).unwrap();
        assert_eq!(write_events(&path, &events()).unwrap(), stamp);
        write_events(&path, &[]).unwrap();
        assert_eq!(read_events(&path).unwrap(), []);
    }

    #[test]
    fn roles_and_parameters_have_columns_with_units() {
        let batch = event::encode(&events()).unwrap();
        let schema = batch.schema();
        let names: Vec<&str> = schema.fields()[10..].iter().map(|field| field.name().as_str()).collect();
        assert_eq!(names, ["agent_track_id", "ego_track_id", "other_track_id", "gap_m", "radius_m", "ttc_s"]);
        assert_eq!(schema.field(13).metadata().get("unit").unwrap(), "m");
        assert_eq!(schema.field(15).metadata().get("unit").unwrap(), "s");
        let columns = crate::store::tables::columns::Columns::of_batch(&batch, Path::new("events"));
        assert_eq!(columns.text("event_id", 2).unwrap(), "interaction/val/DR_CHN_Merging_ZS0/7#cut_in#1");
        assert_eq!(columns.text("place", 0).unwrap(), "DR_CHN_Merging_ZS0");
        assert_eq!(columns.optional_text("ego_track_id", 0).unwrap(), Some("track-0"));
        assert_eq!(columns.optional_text("ego_track_id", 1).unwrap(), None);
    }

    #[test]
    fn a_parameter_cannot_take_the_place_of_a_column() {
        let dir = tempfile::tempdir().unwrap();
        let error =
            write_events(&dir.path().join("e"), &[event(&"a".into(), "cut_in", &[("place", 1.0)])]).unwrap_err();
        assert_eq!(error.to_string(), "cannot store place: a parameter of this name cannot be a column of event.v1");
        assert_eq!(fs_err::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn other_and_damaged_files_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.parquet");
        write_metrics(&path, &Vec::<MetricRow>::new()).unwrap();
        let error = read_events(&path).unwrap_err();
        assert!(matches!(&error, Error::SchemaVersion { found, .. } if found == "metric.v1"), "{error}");
        write_events(&path, &events()).unwrap();
        let whole = fs_err::read(&path).unwrap();
        for len in (0..whole.len()).step_by(53) {
            fs_err::write(&path, &whole[..len]).unwrap();
            let error = read_events(&path).unwrap_err();
            assert!(error.to_string().contains("events.parquet is damaged"), "{error}");
        }
        for at in (0..whole.len()).step_by(7) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x80;
            fs_err::write(&path, damaged).unwrap();
            // A changed value cannot be told, but nothing may panic.
            drop(read_events(&path));
        }
    }
}
