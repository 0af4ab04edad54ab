//! Recordings of one file each, or of two files that arrive in any order: a recording and its companion.

use super::archive::Entry;
use super::error::Error;
use super::files::{MAX_WHOLE_FILE_BYTES, file_name, read_at_most, split_of_entry};
use super::raw::{Companion, RawUnit, UnitSplit};
use super::source::{EmitUnit, UnitReader};
use std::collections::BTreeMap;
use std::io::BufRead;
use std::ops::ControlFlow;

/// The two names of a pair. `*` stands for the same text in both.
#[derive(Debug, Clone, Copy)]
pub(super) struct PairNames<'a> {
    pub(super) recordings: &'a str,
    /// The companions of recordings; `None` if recordings are complete without.
    pub(super) companions: Option<&'a str>,
    /// The most bytes of a file, and the most that may wait for their counterparts.
    pub(super) max_bytes: u64,
    /// The reason to reject a recording without its companion, and what else the user can do.
    pub(super) alone: (&'static str, &'static str),
}

/// The part of a pair that a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PairPart {
    Recording,
    Companion,
}

impl<'a> PairNames<'a> {
    /// Recordings that are complete by themselves.
    pub(super) const fn single(recordings: &'a str) -> Self {
        Self { recordings, companions: None, max_bytes: MAX_WHOLE_FILE_BYTES, alone: ("", "") }
    }

    /// The text for `*` in the name of a file, and which part the file is; `None` if it is neither.
    pub(super) fn part_of<'p>(&self, path: &'p str) -> Option<(&'p str, PairPart)> {
        let within = |pattern: &str| star_of(pattern, file_name(path));
        // `*_tracks.csv` and `*.csv`: the longer one applies.
        let companion = self.companions.and_then(|names| Some((names, within(names)?)));
        match (within(self.recordings), companion) {
            (Some(_), Some((names, star))) if names.len() > self.recordings.len() => Some((star, PairPart::Companion)),
            (Some(star), _) => Some((star, PairPart::Recording)),
            (None, Some((_, star))) => Some((star, PairPart::Companion)),
            (None, None) => None,
        }
    }

    pub(super) fn is_companion(&self, path: &str) -> bool {
        self.part_of(path).is_some_and(|(_, part)| part == PairPart::Companion)
    }
}

/// The text for the first `*` of a pattern in a name; the whole name in a pattern without `*`.
fn star_of<'p>(pattern: &str, name: &'p str) -> Option<&'p str> {
    let Some((prefix, suffix)) = pattern.split_once('*') else { return (pattern == name).then_some(name) };
    name.strip_prefix(prefix)?.strip_suffix(suffix)
}

/// Emits a recording as soon as its companion has arrived, or at once if it needs none.
pub(super) struct PairReader<'a> {
    pub(super) names: PairNames<'a>,
    /// Companions by folder and recording.
    companions: BTreeMap<String, Companion>,
    /// Recordings by folder and recording, with the order of arrival.
    recordings: BTreeMap<String, (u64, RawUnit)>,
    n_arrived: u64,
    n_waiting_bytes: usize,
}

impl<'a> PairReader<'a> {
    pub(super) const fn new(names: PairNames<'a>) -> Self {
        Self { names, companions: BTreeMap::new(), recordings: BTreeMap::new(), n_arrived: 0, n_waiting_bytes: 0 }
    }

    fn recording(&mut self, key: String, mut unit: RawUnit, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        if self.names.companions.is_some() {
            let Some(companion) = self.companions.remove(&key) else {
                self.n_waiting_bytes += unit.bytes.len();
                self.n_arrived += 1;
                self.recordings.insert(key, (self.n_arrived, unit));
                return ControlFlow::Continue(());
            };
            self.n_waiting_bytes -= companion.bytes.len();
            unit.companion = Some(companion);
        }
        emit(Ok(unit))
    }

    fn companion(&mut self, key: String, companion: Companion, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        let Some((_, mut unit)) = self.recordings.remove(&key) else {
            self.n_waiting_bytes += companion.bytes.len();
            if let Some(replaced) = self.companions.insert(key, companion) {
                self.n_waiting_bytes -= replaced.bytes.len();
            }
            return ControlFlow::Continue(());
        };
        self.n_waiting_bytes -= unit.bytes.len();
        unit.companion = Some(companion);
        emit(Ok(unit))
    }
}

impl UnitReader for PairReader<'_> {
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let Some((id, part)) = self.names.part_of(&entry.path) else { return Ok(ControlFlow::Continue(())) };
        let bytes = match read_at_most(entry, reader, self.names.max_bytes) {
            Ok(bytes) => bytes,
            Err(reject) => return Ok(emit(Err(reject))),
        };
        let folder = entry.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let key = format!("{}/{folder}/{id}", entry.container.display());
        let flow = match part {
            PairPart::Companion => self.companion(key, Companion { file: entry.path.clone(), bytes }, emit),
            PairPart::Recording => {
                let unit = RawUnit {
                    file: entry.path.clone(),
                    container: entry.container.clone(),
                    split: UnitSplit::All(split_of_entry(entry)),
                    case_id: id.to_owned(),
                    bytes,
                    first_line: 1,
                    ..RawUnit::default()
                };
                self.recording(key, unit, emit)
            }
        };
        let max_bytes = self.names.max_bytes;
        if self.n_waiting_bytes as u64 > max_bytes {
            let PairNames { recordings, companions, alone: (_, advice), .. } = self.names;
            let (n_mib, companions) = (max_bytes >> 20, companions.unwrap_or_default());
            let detail = format!(
                "more than {n_mib} MiB of files without their counterpart; each `{recordings}` needs `{companions}` \
                 beside it{advice}"
            );
            return Err(Error::Container { container: entry.container.clone(), file: entry.path.clone(), detail });
        }
        Ok(flow)
    }

    fn finish(&mut self, emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        let mut alone: Vec<(u64, RawUnit)> = std::mem::take(&mut self.recordings).into_values().collect();
        alone.sort_by_key(|(arrival, _)| *arrival);
        let PairNames { companions, alone: (reason, advice), .. } = self.names;
        for (_, unit) in alone {
            let companion = companions.unwrap_or_default().replacen('*', &unit.case_id, 1);
            let reject = unit.reject(
                reason,
                format!("{companion} is not among the inputs in the same folder{advice}: give both files, or it"),
            );
            if emit(Err(reject)).is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(ControlFlow::Continue(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::raw::Reject;

    const NAMES: PairNames<'static> = PairNames {
        recordings: "scenario_*.parquet",
        companions: Some("log_map_archive_*.json"),
        max_bytes: 1 << 20,
        alone: ("no_map", ""),
    };

    /// The result of reading these files: `id+map`, `id`, or the reason of a reject.
    fn emitted(companions: Option<&'static str>, paths: &[&str]) -> Vec<String> {
        let mut reader = PairReader::new(PairNames { companions, ..NAMES });
        let mut seen = Vec::new();
        let mut emit = |unit: Result<RawUnit, Reject>| {
            seen.push(match unit {
                Ok(unit) => unit.case_id + if unit.companion.is_some() { "+map" } else { "" },
                Err(reject) => reject.reason.to_owned(),
            });
            ControlFlow::Continue(())
        };
        for path in paths {
            let entry = Entry { path: (*path).to_owned(), container: "c.tar".into(), size: None };
            assert!(reader.read(&entry, &mut path.as_bytes(), &mut emit).expect("small files").is_continue());
        }
        assert!(reader.finish(&mut emit).expect("nothing fails at the end").is_continue());
        assert_eq!(reader.recordings.len(), 0);
        seen
    }

    #[test]
    fn pairs_are_found_in_any_order() {
        let paths = [
            "train/a/scenario_a.parquet",
            "train/b/log_map_archive_b.json",
            "train/b/scenario_b.parquet",
            "train/a/log_map_archive_a.json",
            "train/c/scenario_c.parquet",
            "val/c/log_map_archive_c.json",
        ];
        assert_eq!(emitted(NAMES.companions, &paths), ["b+map", "a+map", "no_map"]);
        assert_eq!(emitted(None, &["train/a/scenario_a.parquet", "train/c/scenario_c.parquet"]), ["a", "c"]);
    }

    #[test]
    fn parts_are_told_by_name() {
        assert_eq!(NAMES.part_of("x/scenario_1-2.parquet"), Some(("1-2", PairPart::Recording)));
        assert_eq!(NAMES.part_of("log_map_archive_1-2.json"), Some(("1-2", PairPart::Companion)));
        assert_eq!(NAMES.part_of("x/1-2.parquet"), None);
        let tables = PairNames { recordings: "*.csv", companions: Some("*_meta.csv"), ..NAMES };
        assert_eq!(tables.part_of("x/01.csv"), Some(("01", PairPart::Recording)));
        assert_eq!(tables.part_of("x/01_meta.csv"), Some(("01", PairPart::Companion)));
        let one = PairNames { recordings: "trajectories.csv", companions: None, ..NAMES };
        assert_eq!(one.part_of("a/trajectories.csv"), Some(("trajectories.csv", PairPart::Recording)));
        assert_eq!(one.part_of("a/other_trajectories.csv"), None);
    }
}
