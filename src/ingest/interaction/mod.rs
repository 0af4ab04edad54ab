//! The formats of INTERACTION.
//!
//! Two versions are in use and are distinguished by their columns. v1.1 has whole recordings, `vehicle_tracks_NNN.csv`
//! and `pedestrian_tracks_NNN.csv` in a folder named for the place, which are cut into windows here. v1.2 has tables of
//! cases of 40 frames, of which 10 are observed; the cases of test sets hold these 10 alone, and mark agents. Maps are
//! Lanelet2 files, each named exactly for its place: v1.1's `DR_CHN_Merging_ZS` is neither v1.2's `ZS0` nor its `ZS2`.
//!
//! An error rejects only its own case. A recording loses its bad rows, and is rejected if they are more than a tenth.
//! Reasons of rejects:
//!
//! - `malformed_row`: too few or too many columns, a cell that is no number, no whole number, or no id; a motorized
//!   agent without `psi_rad`;
//! - `non_finite`: a number is NaN or infinite;
//! - `out_of_range`: a position beyond 1000 km, a speed beyond 1 km/s, a size below a millimeter or beyond 1 km, a
//!   frame that no recording has;
//! - `bad_timestamp`: `timestamp_ms` is not 100 times `frame_id`, the recordings being at 10 Hz;
//! - `duplicate_frame`: a track is at two states at the same frame; rows that are the same count as one;
//! - `too_many_tracks`: more than 100,000 tracks, which no recording has;
//! - `unknown_agent_type`, `inconsistent_agent_type`: not a type of the format; two types in one track;
//! - `ambiguous_id`: two ids that may be one, `7` and `07`, of tracks in a case or recording, or of cases in a file;
//! - `bad_case_id`, `case_not_contiguous`: no usable id; a case whose rows are not together in its file;
//! - `frame_out_of_range`: the frames of a case span more than 40, or those of a recording more than a day;
//! - `recording_repeated`: a file of a recording comes twice, has the bytes of another one, or is named as a copy
//!   (`… (1).csv`);
//! - `recording_too_short`, `window_across_holdout`, `empty_window`: see [`Recording::windows`](super::windows);
//! - `no_rows`, `bad_header`, `unreadable`, `too_large`: of a whole file or case.
//!
//! Tolerated: columns in any order and unknown ones, CRLF, byte order marks, empty lines, a missing last line end,
//! whole numbers printed as floats (ids, too: `1.0` is `1`), sizes that change along a track (the first counts), are
//! blank or `nan`, quotes around cells (closed on their line).

mod cases;
mod columns;
mod path;
mod recordings;
mod row;
mod scenes;
mod survey;
mod track;
mod units;

use super::archive::Entry;
use super::lanelet2;
use super::{Error, Horizon, IngestConfig, MapFile, PendingScene, RawUnit, RecordingSource, UnitReader, map_id};
use crate::scene::{Dataset, MapId};
use path::TrackFile;
use std::io::BufRead;

/// Observed and future timesteps of a v1.2 case, and of v1.1 windows unless configured.
const CASE_HORIZON: Horizon = Horizon { n_history: 10, n_future: 30 };

/// INTERACTION, v1.1 and v1.2.
#[derive(Debug)]
pub(super) struct Interaction<'a> {
    config: &'a IngestConfig,
    horizon: Horizon,
}

impl<'a> Interaction<'a> {
    /// INTERACTION with this configuration.
    pub(super) fn new(config: &'a IngestConfig) -> Self {
        Self { config, horizon: Horizon::of(config, CASE_HORIZON) }
    }

    /// Whether the configuration includes a file, by its name.
    fn wants(&self, file: &TrackFile) -> bool {
        let wants_place = file.place.is_empty() || self.config.wants_place(&file.place);
        wants_place && file.split.is_none_or(|split| self.config.wants_split(split))
    }
}

impl RecordingSource for Interaction<'_> {
    fn horizon(&self) -> Horizon {
        self.horizon
    }

    fn is_recording(&self, path: &str) -> bool {
        TrackFile::of_path(path).is_some_and(|file| self.wants(&file))
    }

    fn is_companion(&self, path: &str) -> bool {
        TrackFile::of_path(path).and_then(|file| file.recording).is_some_and(|part| part.is_pedestrians)
    }

    fn pattern(&self) -> &'static str {
        "*.csv"
    }

    fn unit_reader(&self) -> Box<dyn UnitReader + '_> {
        Box::new(units::TableReader::new(self))
    }

    fn parse(&self, unit: RawUnit) -> Vec<PendingScene<'_>> {
        if unit.header.is_empty() {
            scenes::windows(unit, self.horizon, self.config)
        } else {
            vec![Box::new(move || scenes::case(&unit, self.horizon))]
        }
    }

    fn n_bytes_parsed(&self, unit: &RawUnit) -> u64 {
        let is_recording = unit.header.is_empty();
        // The states of a recording's tracks take about as much memory as its text, and stay until its last window is
        // made.
        unit.n_bytes() * if is_recording { 2 } else { 1 }
    }

    fn map_at(&self, path: &str) -> Option<MapId> {
        let place = path::place_of_map(path).filter(|place| self.config.wants_place(place))?;
        Some(map_id(Dataset::Interaction, place))
    }

    fn place_at(&self, path: &str) -> Option<String> {
        path::place_of_map(path).map(str::to_owned).or_else(|| TrackFile::of_path(path).map(|file| file.place))
    }

    fn read_map(&self, entry: &Entry, reader: &mut dyn BufRead) -> Result<MapFile, Error> {
        let (graph, report) = lanelet2::read_map(reader, &entry.path)?;
        // v1.2 has each map in both forms; Lanelet2 itself reads `.osm`.
        let rank = u8::from(!entry.path.to_ascii_lowercase().ends_with(".osm"));
        Ok(MapFile { graph, rank, report })
    }

    fn map_of(&self, path: &str) -> Option<MapId> {
        let file = TrackFile::of_path(path)?;
        // A name with nothing that names of tracks have may belong to a different kind of table, which needs no map.
        let is_certain = !file.place.is_empty() && (file.recording.is_some() || file.place != path::stem(path));
        is_certain.then(|| map_id(Dataset::Interaction, &file.place))
    }
}

#[cfg(test)]
mod tests;
