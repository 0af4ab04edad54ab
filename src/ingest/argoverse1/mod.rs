//! Argoverse 1 motion forecasting: one CSV file a scene, one vector map a city.

mod even_times;
mod kinematics;
mod smoother;
mod tracks;
mod vector_map;

use super::archive::Entry;
use super::config::IngestConfig;
use super::error::Error;
use super::files::file_name;
use super::pairing::{PairNames, PairReader};
use super::raw::{RawUnit, map_id};
use super::source::{Horizon, MapFile, PendingScene, RecordingSource, UnitReader};
use crate::scene::{Dataset, MapId};
use std::io::BufRead;

#[cfg(test)]
pub(super) use tracks::tests::csv_text;

/// The length of recordings: 2 s of past and 3 s of future at 10 Hz.
const RECORDED: Horizon = Horizon { n_history: 20, n_future: 30 };

/// The formats of Argoverse 1.
pub(super) struct Argoverse1<'a> {
    config: &'a IngestConfig,
    horizon: Horizon,
}

/// Time between timesteps, seconds. The time between rows is uneven.
const DT_S: f64 = 0.1;

impl<'a> Argoverse1<'a> {
    pub(super) fn new(config: &'a IngestConfig) -> Result<Self, Error> {
        Ok(Self { config, horizon: Horizon::within(config, RECORDED)? })
    }
}

impl RecordingSource for Argoverse1<'_> {
    fn horizon(&self) -> Horizon {
        self.horizon
    }

    fn is_recording(&self, path: &str) -> bool {
        path.ends_with(".csv") && self.config.wants_path(path)
    }

    fn pattern(&self) -> &'static str {
        "*.csv"
    }

    fn unit_reader(&self) -> Box<dyn UnitReader + '_> {
        Box::new(PairReader::new(PairNames::single("*.csv")))
    }

    fn parse(&self, unit: RawUnit) -> Vec<PendingScene<'_>> {
        vec![Box::new(move || tracks::parse(&unit, self.horizon, self.config.smooth_tracks))]
    }

    fn map_at(&self, path: &str) -> Option<MapId> {
        vector_map::city_of(file_name(path)).map(|city| map_id(Dataset::Argoverse1, city))
    }

    fn place_at(&self, path: &str) -> Option<String> {
        vector_map::city_of(file_name(path)).map(str::to_owned)
    }

    fn read_map(&self, entry: &Entry, reader: &mut dyn BufRead) -> Result<MapFile, Error> {
        let (graph, report) = vector_map::read(&entry.path, reader)?;
        Ok(MapFile { graph, rank: 0, report })
    }
}
