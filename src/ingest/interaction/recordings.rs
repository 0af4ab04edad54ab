//! Which two files are one v1.1 recording?
//!
//! `vehicle_tracks_NNN.csv` and `pedestrian_tracks_NNN.csv` of a folder belong together, and not every recording has
//! both. A file is held back until its counterpart comes, the folder is left, or too much is held.

use super::path::RecordingPart;
use crate::ingest::{Companion, EmitUnit, RawUnit};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

/// Most bytes held back. One folder of the largest place has about this much.
const MAX_HELD_BYTES: u64 = 128 * 1024 * 1024;

/// The files of the current folder that wait for their counterpart.
#[derive(Debug, Default)]
pub(super) struct Recordings {
    /// Container and folder.
    folder: Folder,
    /// By number of the recording.
    held: BTreeMap<String, Part>,
    n_held_bytes: u64,
    /// The recordings that were emitted.
    done: BTreeSet<(Folder, String)>,
}

type Folder = (std::path::PathBuf, String);

#[derive(Debug)]
struct Part {
    unit: RawUnit,
    is_pedestrians: bool,
}

impl Recordings {
    /// Takes a file in, and emits its recording if that is whole.
    pub(super) fn add(&mut self, unit: RawUnit, part: &RecordingPart, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        let RecordingPart { number, is_pedestrians } = part;
        let key = (self.folder.clone(), number.clone());
        let is_repeated = self.held.get(number).is_some_and(|held| held.is_pedestrians == *is_pedestrians);
        if is_repeated || self.done.contains(&key) {
            let detail = format!(
                "recording {number} was read before without this file; keep the files of a recording in one place, \
                 once each"
            );
            return emit(Err(unit.reject("recording_not_contiguous", detail)));
        }
        if let Some(held) = self.held.remove(number) {
            self.n_held_bytes -= held.unit.n_bytes();
            self.done.insert(key);
            let (vehicles, pedestrians) = if *is_pedestrians { (held.unit, unit) } else { (unit, held.unit) };
            let companion = Some(Companion { file: pedestrians.file, bytes: pedestrians.bytes });
            return emit(Ok(RawUnit { companion, ..vehicles }));
        }
        self.n_held_bytes += unit.n_bytes();
        self.held.insert(number.clone(), Part { unit, is_pedestrians: *is_pedestrians });
        if self.n_held_bytes > MAX_HELD_BYTES { self.flush(emit) } else { ControlFlow::Continue(()) }
    }

    /// Emits what is held of another folder than that of the file at `path` in `container`.
    pub(super) fn enter(
        &mut self,
        container: &std::path::Path,
        path: &str,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
        if self.folder.0 != container || self.folder.1 != folder {
            self.flush(emit)?;
            self.folder = (container.to_owned(), folder.to_owned());
        }
        ControlFlow::Continue(())
    }

    /// Emits all that is held, each file as a recording of its own.
    pub(super) fn flush(&mut self, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        self.n_held_bytes = 0;
        for (number, part) in std::mem::take(&mut self.held) {
            self.done.insert((self.folder.clone(), number));
            emit(Ok(part.unit))?;
        }
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adds files in this order and lists what comes out: `vehicles+pedestrians` of each unit, or the reason of a reject.
    fn add_all(paths: &[&str]) -> Vec<String> {
        let mut recordings = Recordings::default();
        let mut seen = Vec::new();
        let mut emit = |unit: Result<RawUnit, crate::ingest::Reject>| {
            seen.push(match unit {
                Ok(RawUnit { file, companion: Some(companion), .. }) => format!("{file}+{}", companion.file),
                Ok(unit) => unit.file,
                Err(reject) => reject.reason.to_owned(),
            });
            ControlFlow::Continue(())
        };
        for path in paths {
            let file = super::super::path::TrackFile::of_path(path).unwrap();
            let unit = RawUnit { file: (*path).to_owned(), ..RawUnit::default() };
            assert!(recordings.enter(std::path::Path::new("data"), path, &mut emit).is_continue());
            assert!(recordings.add(unit, &file.recording.unwrap(), &mut emit).is_continue());
        }
        assert!(recordings.flush(&mut emit).is_continue());
        seen
    }

    #[test]
    fn both_files_of_a_recording_are_one_unit() {
        let paths = [
            "A/pedestrian_tracks_000.csv",
            "A/pedestrian_tracks_002.csv",
            "A/vehicle_tracks_000.csv",
            "A/vehicle_tracks_001.csv",
            "B/vehicle_tracks_000.csv",
            "B/pedestrian_tracks_000.csv",
        ];
        let expected = [
            "A/vehicle_tracks_000.csv+A/pedestrian_tracks_000.csv",
            "A/vehicle_tracks_001.csv",
            "A/pedestrian_tracks_002.csv",
            "B/vehicle_tracks_000.csv+B/pedestrian_tracks_000.csv",
        ];
        assert_eq!(add_all(&paths), expected);
    }

    #[test]
    fn a_part_that_comes_too_late_or_twice_is_rejected() {
        let paths = ["A/vehicle_tracks_000.csv", "B/vehicle_tracks_000.csv", "A/pedestrian_tracks_000.csv"];
        let late = ["A/vehicle_tracks_000.csv", "B/vehicle_tracks_000.csv", "recording_not_contiguous"];
        assert_eq!(add_all(&paths), late);
        let paths = ["A/vehicle_tracks_000.csv", "A/vehicle_tracks_000.csv"];
        assert_eq!(add_all(&paths), ["recording_not_contiguous", "A/vehicle_tracks_000.csv"]);
    }
}
