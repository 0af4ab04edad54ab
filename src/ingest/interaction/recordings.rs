//! Joins the two files of a v1.1 recording.
//!
//! `vehicle_tracks_NNN.csv` and `pedestrian_tracks_NNN.csv` of a folder belong together, and not every recording has
//! both. A first pass finds out which do. The earlier file of a pair is held until the other one arrives; pairs that do
//! not fit into memory wait for further passes.

use super::path::RecordingPart;
use crate::ingest::archive::Entry;
use crate::ingest::{Companion, EmitUnit, RawUnit};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Maximum number of bytes held at a time, unless a single file has more.
const MAX_HELD_BYTES: u64 = 16 * 1024 * 1024;

/// The recordings of all inputs, and their files that wait for their counterpart.
#[derive(Debug, Default)]
pub(super) struct Recordings {
    /// The first file of each recording that the first pass saw.
    first_files: BTreeMap<RecordingKey, FirstFile>,
    pairs: BTreeMap<RecordingKey, Pair>,
    n_noted: usize,
    held: BTreeMap<RecordingKey, RawUnit>,
    /// The files that were added; those of pedestrians are marked.
    done: BTreeSet<(RecordingKey, bool)>,
}

/// Container, folder and number of a recording.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RecordingKey(PathBuf, String, String);

impl RecordingKey {
    /// The recording that the file `entry` belongs to.
    pub(super) fn of(entry: &Entry, part: &RecordingPart) -> Self {
        let folder = entry.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        Self(entry.container.clone(), folder.to_owned(), part.number.clone())
    }
}

#[derive(Debug)]
struct FirstFile {
    is_pedestrians: bool,
    n_bytes: u64,
    /// Its position among all files.
    position: usize,
}

/// Both files of a recording.
#[derive(Debug)]
struct Pair {
    /// The pass in which they are read, counted from 0.
    pass: usize,
    /// The size of the file that is held, until the file at this position.
    n_bytes: u64,
    until: usize,
    /// One of them could not be read.
    is_broken: bool,
}

impl Recordings {
    /// Registers a file. Call it for all files in their order before adding any.
    pub(super) fn note(&mut self, key: RecordingKey, is_pedestrians: bool, n_bytes: u64) {
        let position = self.n_noted;
        self.n_noted += 1;
        let Some(first) = self.first_files.get(&key) else {
            self.first_files.insert(key, FirstFile { is_pedestrians, n_bytes, position });
            return;
        };
        if first.is_pedestrians == is_pedestrians || self.pairs.contains_key(&key) {
            return;
        }
        // Earlier pairs end before it does: they are held together with it if they end after it begins.
        let mut held_in: BTreeMap<usize, u64> = BTreeMap::new();
        for pair in self.pairs.values().filter(|pair| pair.until > first.position) {
            *held_in.entry(pair.pass).or_default() += pair.n_bytes;
        }
        let has_room = |pass: &usize| held_in.get(pass).is_none_or(|held| held + first.n_bytes <= MAX_HELD_BYTES);
        let pass = (0..).find(has_room).unwrap_or_default();
        self.pairs.insert(key, Pair { pass, n_bytes: first.n_bytes, until: position, is_broken: false });
    }

    /// The pass in which the files of a recording are read, counted from 0.
    pub(super) fn pass_of(&self, key: &RecordingKey) -> usize {
        self.pairs.get(key).map_or(0, |pair| pair.pass)
    }

    /// The number of passes that all recordings need.
    pub(super) fn n_passes(&self) -> usize {
        self.pairs.values().map(|pair| pair.pass + 1).max().unwrap_or(0)
    }

    /// Adds a file, and emits its recording if that is complete.
    pub(super) fn add(
        &mut self,
        key: RecordingKey,
        unit: RawUnit,
        is_pedestrians: bool,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        if !self.done.insert((key.clone(), is_pedestrians)) {
            let detail = format!("this file of recording {} was read before; give each file once", key.2);
            return emit(Err(unit.reject("recording_repeated", detail)));
        }
        if self.pairs.get(&key).is_none_or(|pair| pair.is_broken) {
            return emit(Ok(unit));
        }
        let Some(held) = self.held.remove(&key) else {
            self.held.insert(key, unit);
            return ControlFlow::Continue(());
        };
        let (vehicles, pedestrians) = if is_pedestrians { (held, unit) } else { (unit, held) };
        let companion = Some(Companion { file: pedestrians.file, bytes: pedestrians.bytes });
        emit(Ok(RawUnit { companion, ..vehicles }))
    }

    /// Notes that a file cannot be read, so that its counterpart is a recording of its own.
    pub(super) fn give_up(&mut self, key: &RecordingKey, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        if let Some(pair) = self.pairs.get_mut(key) {
            pair.is_broken = true;
        }
        self.held.remove(key).map_or(ControlFlow::Continue(()), |unit| emit(Ok(unit)))
    }

    /// Emits the held files, each as a recording of its own: its counterpart was there in the first pass and has
    /// disappeared.
    pub(super) fn flush(&mut self, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        std::mem::take(&mut self.held).into_values().try_for_each(|unit| emit(Ok(unit)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::path::TrackFile;
    use super::*;

    /// Adds files of these sizes and lists the result, pass by pass: `vehicles+pedestrians` of each unit, or the reason
    /// of a reject. A file with `!` in its name cannot be read. Also returns the most bytes that were held.
    fn add_all(files: &[(&str, u64)]) -> (Vec<Vec<String>>, u64) {
        let mut recordings = Recordings::default();
        let found: Vec<(RecordingKey, RecordingPart, RawUnit, u64)> = files
            .iter()
            .map(|(path, n_bytes)| {
                let part = TrackFile::of_path(&path.replace('!', "")).unwrap().recording.unwrap();
                let entry = Entry { path: (*path).to_owned(), container: "data".into(), size: None };
                let unit = RawUnit { file: (*path).to_owned(), ..RawUnit::default() };
                (RecordingKey::of(&entry, &part), part, unit, *n_bytes)
            })
            .collect();
        for (key, part, _, n_bytes) in &found {
            recordings.note(key.clone(), part.is_pedestrians, *n_bytes);
        }
        let size_of = |file: &str| files.iter().find(|(path, _)| *path == file).unwrap().1;
        let (mut passes, mut most_held) = (Vec::new(), 0);
        for pass in 0..recordings.n_passes().max(1) {
            let mut seen = Vec::new();
            let mut emit = |unit: Result<RawUnit, crate::ingest::Reject>| {
                seen.push(match unit {
                    Ok(RawUnit { file, companion: Some(companion), .. }) => format!("{file}+{}", companion.file),
                    Ok(unit) => unit.file,
                    Err(reject) => reject.reason.to_owned(),
                });
                ControlFlow::Continue(())
            };
            for (key, part, unit, _) in &found {
                if recordings.pass_of(key) != pass {
                    continue;
                }
                let flow = match unit.file.contains('!') {
                    true => recordings.give_up(key, &mut emit),
                    false => recordings.add(key.clone(), unit.clone(), part.is_pedestrians, &mut emit),
                };
                assert!(flow.is_continue());
                most_held = most_held.max(recordings.held.values().map(|unit| size_of(&unit.file)).sum());
            }
            passes.push(seen);
        }
        assert!(recordings.held.is_empty());
        (passes, most_held)
    }

    #[test]
    fn both_files_of_a_recording_are_one_unit() {
        let files = [
            "A/pedestrian_tracks_000.csv",
            "A/pedestrian_tracks_002.csv",
            "A/vehicle_tracks_000.csv",
            "A/vehicle_tracks_001.csv",
            "B/vehicle_tracks_000.csv",
            "B/pedestrian_tracks_000.csv",
            "A/vehicle_tracks_003.csv",
            "A/pedestrian_tracks_001.csv",
        ];
        let expected = [
            "A/pedestrian_tracks_002.csv",
            "A/vehicle_tracks_000.csv+A/pedestrian_tracks_000.csv",
            "B/vehicle_tracks_000.csv+B/pedestrian_tracks_000.csv",
            "A/vehicle_tracks_003.csv",
            "A/vehicle_tracks_001.csv+A/pedestrian_tracks_001.csv",
        ];
        assert_eq!(add_all(&files.map(|file| (file, 1 << 20))), (vec![expected.map(str::to_owned).to_vec()], 2 << 20));
    }

    #[test]
    fn no_more_is_held_than_fits() {
        let names = |kind: &str| (0..9).map(|i| format!("A/{kind}_tracks_{i:03}.csv")).collect::<Vec<_>>();
        let (pedestrians, vehicles) = (names("pedestrian"), names("vehicle"));
        let by_name: Vec<(&str, u64)> =
            pedestrians.iter().chain(&vehicles).map(|file| (file.as_str(), 5 << 20)).collect();
        let (passes, most_held) = add_all(&by_name);
        assert_eq!((passes.iter().map(Vec::len).collect::<Vec<_>>(), most_held), (vec![3, 3, 3], 15 << 20));
        let emitted: Vec<String> = passes.concat();
        let expected: Vec<String> = vehicles.iter().zip(&pedestrians).map(|(v, p)| format!("{v}+{p}")).collect();
        assert_eq!(emitted, expected);
        // Pairs of adjacent files are never held together.
        let by_number: Vec<(&str, u64)> =
            pedestrians.iter().zip(&vehicles).flat_map(|(p, v)| [(p.as_str(), 50 << 20), (v.as_str(), 1)]).collect();
        let (passes, most_held) = add_all(&by_number);
        assert_eq!((passes.len(), passes[0].len(), most_held), (1, 9, 50 << 20));
    }

    #[test]
    fn a_file_that_comes_twice_is_rejected_and_one_that_cannot_be_read_leaves_the_other() {
        let twice = [("A/vehicle_tracks_000.csv", 1), ("A/vehicle_tracks_000.csv", 1)];
        assert_eq!(add_all(&twice).0, [["A/vehicle_tracks_000.csv", "recording_repeated"]]);
        for files in [
            ["A/pedestrian_tracks_000.csv", "A/!vehicle_tracks_000.csv"],
            ["A/!vehicle_tracks_000.csv", "A/pedestrian_tracks_000.csv"],
        ] {
            assert_eq!(add_all(&files.map(|file| (file, 1))).0, [["A/pedestrian_tracks_000.csv"]]);
        }
    }
}
