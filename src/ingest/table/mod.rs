//! Tables without a format of their own, read with a mapping in the configuration.
//!
//! A file has one recording or several, each with any number of tracks, whose rows may be in any order and at any
//! times: they are resampled to 10 Hz. A long one is read in parts ([`parts`]). The scenes of a recording are windows
//! of it. A map is a file in Lanelet2 or OpenDRIVE with the name of the place.
//!
//! What is bad is left out, counted and named: a row that cannot be read or is out of place, an agent whose class, size
//! or times cannot be. A recording is rejected if more than a tenth of its rows or half of its agents are bad.
//!
//! Reasons of rejects, of recordings or whole files:
//!
//! - `bad_table`: no CSV or Parquet, rows of different lengths, cells that are no numbers, blank positions or times;
//! - `missing_column`, `missing_track`: of those that the mapping names, and of the table of tracks;
//! - `out_of_range`, `implausible_times`, `implausible_positions`: positions beyond the earth, a size below zero or
//!   beyond 1 km; rows that are seconds or days apart; jumps that no vehicle makes;
//! - `duplicate_time`, `duplicate_track`: a track is at two positions at one time, or twice in the table of tracks;
//! - `unknown_class`: a class that the mapping does not list;
//! - `no_track_file`: the table of tracks is not beside the recording;
//! - `no_rows`, `unreadable`, `too_large`, and those of [`windows`](super::windows).

mod agents;
mod columns;
mod headings;
mod left_out;
mod mapping;
mod owners;
mod part_plan;
mod parts;
#[cfg(test)]
mod parts_tests;
mod resample;
mod rows;
mod sizes;
mod table_rows;
#[cfg(test)]
mod tests;
mod timed_rows;
mod tracks;
mod turns;

pub use mapping::{HeadingUnit, PositionOf, TableColumns, TableMapping};

use self::part_plan::{Planner, SIZES, Sizes};
use self::parts::PartReader;
use super::archive::Entry;
use super::files::file_stem;
use super::pairing::{PairNames, PairReader};
use super::windows::Recording;
use super::{
    Error, Horizon, IngestConfig, MapFile, PendingScene, RawUnit, RecordingSource, Reject, UnitReader, UnitSplit,
    lanelet2, map_id, opendrive,
};
use crate::scene::{Dataset, MapId, Split};
use std::io::BufRead;

/// One second of past and three of future.
const USUAL: Horizon = Horizon { n_history: 10, n_future: 30 };

/// Maximum size of a table of tracks, and of all files that wait for theirs.
const MAX_FILE_BYTES: u64 = 512 << 20;

pub(super) struct Tables<'a> {
    config: &'a IngestConfig,
    mapping: &'a TableMapping,
    horizon: Horizon,
}

impl<'a> Tables<'a> {
    pub(super) fn new(config: &'a IngestConfig) -> Result<Self, Error> {
        let detail = "is missing: dataset = \"table\" needs the meaning of its columns, see configs/README.md";
        let missing = || Error::Config { key: "table".to_owned(), detail: detail.to_owned() };
        let mapping = config.table.as_ref().ok_or_else(missing)?;
        Ok(Self { config, mapping, horizon: Horizon::of(config, USUAL) })
    }

    fn part_reader(&self, sizes: Sizes) -> PartReader<'_> {
        let Self { config, mapping, horizon } = *self;
        PartReader::new(PairReader::new(self.names()), Planner { mapping, config, horizon, sizes })
    }

    fn names(&self) -> PairNames<'a> {
        PairNames {
            recordings: &self.mapping.files,
            companions: self.mapping.track_files.as_deref(),
            max_bytes: MAX_FILE_BYTES,
            alone: ("no_track_file", ", where ingest.table.track_files expects it"),
        }
    }
}

impl RecordingSource for Tables<'_> {
    fn horizon(&self) -> Horizon {
        self.horizon
    }

    fn is_recording(&self, path: &str) -> bool {
        self.names().part_of(path).is_some() && self.config.wants_path(path)
    }

    fn is_companion(&self, path: &str) -> bool {
        self.names().is_companion(path)
    }

    fn unit_reader(&self) -> Box<dyn UnitReader + '_> {
        Box::new(self.part_reader(SIZES))
    }

    fn parse(&self, mut unit: RawUnit) -> Vec<PendingScene<'_>> {
        if unit.split == UnitSplit::All(Split::Unsplit) {
            unit.split = UnitSplit::Divided;
        }
        // Files with the same name in different folders are different recordings.
        unit.case_id = unit.file.rsplit_once('.').map_or(unit.file.as_str(), |(path, _)| path).replace('/', "-");
        let scenes = |recording: Result<Recording, Reject>| -> Vec<PendingScene<'static>> {
            match recording {
                Ok(recording) => recording.windows(self.horizon, self.config),
                Err(reject) => vec![Box::new(|| Err(reject))],
            }
        };
        tracks::recordings(unit, self.mapping).into_iter().flat_map(scenes).collect()
    }

    fn n_bytes_parsed(&self, unit: &RawUnit) -> u64 {
        // Columns and states take about as much memory as the text.
        unit.n_bytes() * 2
    }

    fn map_at(&self, path: &str) -> Option<MapId> {
        let place = place_of_map(path)?;
        self.config.wants_place(place).then(|| map_id(Dataset::Table, place))
    }

    fn read_map(&self, entry: &Entry, reader: &mut dyn BufRead) -> Result<MapFile, Error> {
        let is_opendrive = entry.path.ends_with(".xodr");
        let read = if is_opendrive { opendrive::read_map } else { lanelet2::read_map };
        let (graph, report) = read(reader, &entry.path)?;
        Ok(MapFile { graph, rank: u8::from(is_opendrive), report })
    }

    fn place_at(&self, path: &str) -> Option<String> {
        place_of_map(path).map(str::to_owned)
    }
}

fn place_of_map(path: &str) -> Option<&str> {
    [".osm", ".xodr"].iter().any(|suffix| path.ends_with(suffix)).then(|| file_stem(path))
}
