//! `events.parquet`: the mined events.

use super::parquet_file::ParquetFile;
use super::tables::event::{self, EventNames};
use super::{Result, row_file};
use crate::behavior::{BehaviorEntry, BehaviorEvent};
use crate::files::FileStamp;
use std::path::{Path, PathBuf};

/// Writes an event table, some scenes at a time, holding one row group in memory.
pub struct EventWriter<'n> {
    path: PathBuf,
    names: EventNames<'n>,
    file: Option<ParquetFile>,
}

impl<'n> EventWriter<'n> {
    /// Begins a table with a column for each role and parameter that these behaviors declare, whether or not an event
    /// has it.
    pub fn new(path: &Path, behaviors: impl IntoIterator<Item = &'n BehaviorEntry>) -> Self {
        let mut names = EventNames::default();
        for behavior in behaviors {
            names.roles.extend(behavior.roles);
            names.parameters.extend(behavior.parameters);
        }
        Self { path: path.to_owned(), names, file: None }
    }

    /// Adds all events of some scenes.
    ///
    /// # Errors
    /// [`Error::Invalid`](super::Error::Invalid) when an event has a role or a parameter that no behavior declares, or
    /// a parameter has the name of another column; errors of the file system.
    pub fn write(&mut self, events: &[BehaviorEvent]) -> Result<()> {
        self.write_numbered(events, &event::numbers_of(events))
    }

    /// Adds events that are numbers so and so among those of their scene and behavior.
    pub fn write_numbered(&mut self, events: &[BehaviorEvent], numbers: &[usize]) -> Result<()> {
        let batch = event::encode(events, numbers, &self.names)?;
        let file = match &mut self.file {
            Some(file) => file,
            None => self.file.insert(ParquetFile::create(&self.path, &event::schema(), batch.schema())?),
        };
        file.write(&batch)
    }

    /// Finishes the table and gives the file its name.
    pub fn finish(mut self) -> Result<FileStamp> {
        if self.file.is_none() {
            self.write(&[])?;
        }
        match self.file {
            Some(file) => file.finish(),
            None => Err(super::Error::invalid("events", "no table was begun")),
        }
    }
}

/// Reads the events that `keep` accepts, in the order in which they were written. The others take no memory.
pub fn read_events(path: &Path, keep: impl Fn(&BehaviorEvent) -> bool) -> Result<Vec<BehaviorEvent>> {
    stream_events(path)?.filter(|event| event.as_ref().map_or(true, &keep)).collect()
}

/// Reads a table of events one by one, in the order they were written; few are in memory at a time.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or an event is damaged; errors of the file system.
pub fn stream_events(path: &Path) -> Result<impl Iterator<Item = Result<BehaviorEvent>> + use<>> {
    row_file::stream(path, &event::schema(), event::decode)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{self, EventLabel};
    use crate::metrics::MetricRow;
    use crate::scene::SceneId;
    use crate::store::parquet_file;
    use crate::store::testing::event;
    use crate::store::{Error, write_table};
    use std::collections::BTreeSet;

    fn write_events(path: &Path, events: &[BehaviorEvent]) -> Result<FileStamp> {
        let mut writer = EventWriter { path: path.to_owned(), names: names_of(events), file: None };
        writer.write(events)?;
        writer.finish()
    }

    /// The parameters and roles that occur in these events.
    fn names_of(events: &[BehaviorEvent]) -> EventNames<'_> {
        EventNames {
            roles: events.iter().flat_map(|event| event.roles.names()).collect(),
            parameters: events.iter().flat_map(|event| event.parameters.keys()).map(String::as_str).collect(),
        }
    }

    fn read_all(path: &Path) -> Result<Vec<BehaviorEvent>> {
        read_events(path, |_| true)
    }

    fn events() -> Vec<BehaviorEvent> {
        let scene = SceneId::from("interaction/val/DR_CHN_Merging_ZS0/7");
        let cut_in = event(&scene, "cut_in", &[("gap_m", 0.1 + 0.2), ("ttc_s", 1.5)]);
        let turn = BehaviorEvent {
            roles: crate::scene::Roles::from([("agent", "9")]),
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
        assert_eq!(read_all(&path).unwrap(), events());
        stamp.verify_file(&path).unwrap();
        assert_eq!(write_events(&path, &events()).unwrap(), stamp);
        write_events(&path, &[]).unwrap();
        assert_eq!(read_all(&path).unwrap(), []);
    }

    #[test]
    fn roles_and_parameters_have_columns_with_units() {
        let events = events();
        let batch = event::encode(&events, &event::numbers_of(&events), &names_of(&events)).unwrap();
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
    fn tables_are_written_some_scenes_at_a_time_with_the_columns_of_their_behaviors() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.parquet");
        let of = |scene: &str| event(&SceneId::from(scene), "cut_in", &[("gap_m", 1.0)]);
        let (first, second) = (vec![of("a/b/c/1"), of("a/b/c/1")], vec![of("a/b/c/2")]);
        let mut writer = EventWriter::new(&path, behavior::ALL.iter().filter(|entry| entry.id == "cut_in"));
        writer.write(&first).unwrap();
        writer.write(&[]).unwrap();
        writer.write(&second).unwrap();
        assert!(!path.exists());
        writer.finish().unwrap();
        assert_eq!(read_all(&path).unwrap(), [first, second.clone()].concat());
        assert_eq!(read_events(&path, |event| event.scene_id.0.ends_with('2')).unwrap(), second);
        let batch = &parquet_file::read(&path, &event::schema()).unwrap()[0];
        let schema = batch.schema();
        let columns: BTreeSet<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        assert!(columns.is_superset(&BTreeSet::from(["ego_track_id", "other_track_id", "gap_m", "ttc_s"])));
        assert!(!columns.contains("radius_m"));
    }

    #[test]
    fn what_no_behavior_declares_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.parquet");
        let refusal =
            |event: BehaviorEvent| EventWriter::new(&path, behavior::ALL).write(&[event]).unwrap_err().to_string();
        let message = refusal(event(&"a".into(), "cut_in", &[("charm_m", 1.0)]));
        assert!(message.contains("charm_m") && message.contains("does not declare"), "{message}");
        let roles = crate::scene::Roles::from([("bystander", "1")]);
        assert!(refusal(BehaviorEvent { roles, ..event(&"a".into(), "cut_in", &[]) }).contains("bystander"));
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
        write_table(&path, Vec::<Result<MetricRow>>::new()).unwrap();
        let error = read_all(&path).unwrap_err();
        assert!(matches!(&error, Error::SchemaVersion { found, .. } if found == "metric.v1"), "{error}");
        write_events(&path, &events()).unwrap();
        let whole = fs_err::read(&path).unwrap();
        for len in (0..whole.len()).step_by(53) {
            fs_err::write(&path, &whole[..len]).unwrap();
            let error = read_all(&path).unwrap_err();
            assert!(error.to_string().contains("events.parquet is damaged"), "{error}");
        }
        for at in (0..whole.len()).step_by(7) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x80;
            fs_err::write(&path, damaged).unwrap();
            // A changed value cannot be detected, but nothing may panic.
            drop(read_all(&path));
        }
    }
}
