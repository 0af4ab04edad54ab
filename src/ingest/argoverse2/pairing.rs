//! Pairs scenarios with their maps, two files that come in any order.

use crate::ingest::archive::Entry;
use crate::ingest::error::Error;
use crate::ingest::files::{file_name, read_whole, split_of_entry};
use crate::ingest::raw::{Companion, RawUnit, Reject, UnitSplit};
use crate::ingest::source::{EmitUnit, UnitReader};
use std::collections::BTreeMap;
use std::io::BufRead;
use std::ops::ControlFlow;

/// Bytes that may wait for their counterpart. Archives have the two files of a scenario side by side.
const MAX_WAITING_BYTES: usize = 128 << 20;

/// The kind of a file of a scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ScenarioFile {
    Scenario,
    Map,
}

/// The scenario and the kind of a file: `scenario_<id>.parquet`, `log_map_archive_<id>.json`.
pub(super) fn part_of(path: &str) -> Option<(&str, ScenarioFile)> {
    let name = file_name(path);
    let within = |prefix: &str, suffix: &str| name.strip_prefix(prefix)?.strip_suffix(suffix);
    if let Some(id) = within("scenario_", ".parquet") {
        return Some((id, ScenarioFile::Scenario));
    }
    within("log_map_archive_", ".json").map(|id| (id, ScenarioFile::Map))
}

/// Emits a scenario as soon as its map has come, or at once if maps are not read.
pub(super) struct PairReader {
    needs_maps: bool,
    /// By folder and scenario.
    maps: BTreeMap<String, Companion>,
    /// By folder and scenario, with the order of arrival.
    scenarios: BTreeMap<String, (u64, RawUnit)>,
    n_arrived: u64,
    n_waiting_bytes: usize,
}

impl PairReader {
    pub(super) const fn new(needs_maps: bool) -> Self {
        Self { needs_maps, maps: BTreeMap::new(), scenarios: BTreeMap::new(), n_arrived: 0, n_waiting_bytes: 0 }
    }

    fn scenario(&mut self, key: String, mut unit: RawUnit, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        if self.needs_maps {
            let Some(map) = self.maps.remove(&key) else {
                self.n_waiting_bytes += unit.bytes.len();
                self.n_arrived += 1;
                self.scenarios.insert(key, (self.n_arrived, unit));
                return ControlFlow::Continue(());
            };
            self.n_waiting_bytes -= map.bytes.len();
            unit.companion = Some(map);
        }
        emit(Ok(unit))
    }

    fn map(&mut self, key: String, map: Companion, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        let Some((_, mut unit)) = self.scenarios.remove(&key) else {
            self.n_waiting_bytes += map.bytes.len();
            if let Some(replaced) = self.maps.insert(key, map) {
                self.n_waiting_bytes -= replaced.bytes.len();
            }
            return ControlFlow::Continue(());
        };
        self.n_waiting_bytes -= unit.bytes.len();
        unit.companion = Some(map);
        emit(Ok(unit))
    }
}

impl UnitReader for PairReader {
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let Some((id, part)) = part_of(&entry.path) else { return Ok(ControlFlow::Continue(())) };
        let bytes = match read_whole(entry, reader) {
            Ok(bytes) => bytes,
            Err(reject) => return Ok(emit(Err(reject))),
        };
        let folder = entry.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let key = format!("{}/{folder}/{id}", entry.container.display());
        let flow = match part {
            ScenarioFile::Map => self.map(key, Companion { file: entry.path.clone(), bytes }, emit),
            ScenarioFile::Scenario => {
                let unit = RawUnit {
                    file: entry.path.clone(),
                    container: entry.container.clone(),
                    split: UnitSplit::All(split_of_entry(entry)),
                    case_id: id.to_owned(),
                    bytes,
                    first_line: 1,
                    ..RawUnit::default()
                };
                self.scenario(key, unit, emit)
            }
        };
        if self.n_waiting_bytes > MAX_WAITING_BYTES {
            let detail = "more than 128 MiB of scenarios and maps without their counterpart; each \
                          `scenario_<id>.parquet` needs `log_map_archive_<id>.json` beside it, or set \
                          `ingest.maps = \"none\"`";
            return Err(Error::Container {
                container: entry.container.clone(),
                file: entry.path.clone(),
                detail: detail.to_owned(),
            });
        }
        Ok(flow)
    }

    fn finish(&mut self, emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        let mut alone: Vec<(u64, RawUnit)> = std::mem::take(&mut self.scenarios).into_values().collect();
        alone.sort_by_key(|(arrival, _)| *arrival);
        for (_, unit) in alone {
            let detail = format!("its map log_map_archive_{}.json is not in the same folder", unit.case_id);
            let reject = Reject { reason: "no_map", detail: format!("{}: {detail}", unit.file) };
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

    /// The result of reading these files: `id+map`, `id`, or the reason of a reject.
    fn emitted(needs_maps: bool, paths: &[&str]) -> Vec<String> {
        let mut reader = PairReader::new(needs_maps);
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
        assert_eq!(reader.scenarios.len(), 0);
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
        assert_eq!(emitted(true, &paths), ["b+map", "a+map", "no_map"]);
        assert_eq!(emitted(false, &["train/a/scenario_a.parquet", "train/c/scenario_c.parquet"]), ["a", "c"]);
    }

    #[test]
    fn parts_are_told_by_name() {
        assert_eq!(part_of("x/scenario_1-2.parquet"), Some(("1-2", ScenarioFile::Scenario)));
        assert_eq!(part_of("log_map_archive_1-2.json"), Some(("1-2", ScenarioFile::Map)));
        assert_eq!(part_of("x/1-2.parquet"), None);
    }
}
