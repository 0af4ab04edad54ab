//! Argoverse 2 motion forecasting: one parquet file and one map a scenario.

mod map;
mod tracks;

use super::config::IngestConfig;
use super::error::Error;
use super::pairing::{PairNames, PairReader};
use super::raw::{RawScene, RawUnit, Reject};
use super::source::{Horizon, PendingScene, RecordingSource, UnitReader};
use std::sync::Arc;

#[cfg(test)]
pub(super) use tracks::tests::scenario_bytes;

/// The length of recordings: 5 s of past and 6 s of future at 10 Hz.
const RECORDED: Horizon = Horizon { n_history: 50, n_future: 60 };

/// Bytes that may wait for their counterpart. Archives have the two files of a scenario side by side.
const MAX_WAITING_BYTES: u64 = 128 << 20;

/// The formats of Argoverse 2.
pub(super) struct Argoverse2<'a> {
    config: &'a IngestConfig,
    horizon: Horizon,
}

impl<'a> Argoverse2<'a> {
    pub(super) fn new(config: &'a IngestConfig) -> Result<Self, Error> {
        Ok(Self { config, horizon: Horizon::within(config, RECORDED)? })
    }
}

impl RecordingSource for Argoverse2<'_> {
    fn horizon(&self) -> Horizon {
        self.horizon
    }

    fn is_recording(&self, path: &str) -> bool {
        self.names().part_of(path).is_some() && self.config.wants_path(path)
    }

    fn is_companion(&self, path: &str) -> bool {
        self.names().is_companion(path)
    }

    fn pattern(&self) -> &'static str {
        "scenario_*.parquet"
    }

    fn unit_reader(&self) -> Box<dyn UnitReader + '_> {
        Box::new(PairReader::new(self.names()))
    }

    fn parse(&self, unit: RawUnit) -> Vec<PendingScene<'_>> {
        vec![Box::new(move || self.parse_scenario(&unit))]
    }

    fn has_own_maps(&self) -> bool {
        true
    }
}

impl Argoverse2<'_> {
    fn names(&self) -> PairNames<'static> {
        PairNames {
            recordings: "scenario_*.parquet",
            companions: self.config.wants_maps().then_some("log_map_archive_*.json"),
            max_bytes: MAX_WAITING_BYTES,
            alone: ("no_map", "; or set `ingest.maps = \"none\"`"),
        }
    }

    fn parse_scenario(&self, unit: &RawUnit) -> Result<RawScene, Reject> {
        let mut scene = tracks::parse(unit, self.horizon)?;
        if let Some(companion) = &unit.companion {
            let (graph, report) = map::parse(&companion.bytes)
                .map_err(|detail| Reject { reason: "bad_map", detail: format!("{}: {detail}", companion.file) })?;
            scene.own_map = Some(Arc::new(graph));
            scene.findings.extend(report.findings(&companion.file));
        }
        Ok(scene)
    }
}
