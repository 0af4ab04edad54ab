//! The interface of datasets to ingest.

use super::archive::Entry;
use super::config::IngestConfig;
use super::error::Error;
use super::map_report::MapReport;
use super::raw::{RawScene, RawUnit, Reject};
use crate::scene::{LaneGraph, MapId};
use std::io::BufRead;
use std::ops::ControlFlow;

/// The formats of one dataset. Files are read one after another by a [`UnitReader`]; units are parsed in parallel.
pub trait RecordingSource: Sync {
    /// The timesteps of scenes, if the recording has as many.
    fn horizon(&self) -> Horizon;

    /// Whether the entry at `path` holds recordings (or maps, if scenes bring their own) that the configuration
    /// includes. Called before the entry is read, so that others are skipped cheaply.
    fn is_recording(&self, path: &str) -> bool;

    /// The names of such files, for messages; empty if the configuration says them.
    fn pattern(&self) -> &'static str {
        ""
    }

    /// Whether such a file belongs to a recording in another one. Companions of different recordings may be alike.
    fn is_companion(&self, _path: &str) -> bool {
        false
    }

    /// A reader that cuts entries into units, in the order of the entries.
    fn unit_reader(&self) -> Box<dyn UnitReader + '_>;

    /// The scenes of a unit in a fixed order, at least one: a unit without any is a reject. A recording has thousands,
    /// so each is made on demand.
    fn parse(&self, unit: RawUnit) -> Vec<PendingScene<'_>>;

    /// The approximate memory of a unit while it is parsed, without its scenes, bytes; it determines the size of
    /// batches. Only sources that keep parsed data need to return more than the size of the unit.
    fn n_bytes_parsed(&self, unit: &RawUnit) -> u64 {
        unit.n_bytes()
    }

    /// Whether scenes bring their own maps, so that none are read beforehand.
    fn has_own_maps(&self) -> bool {
        false
    }

    /// The id of the map in the entry at `path`, to be read before all recordings; `None` if it is not a map, or scenes
    /// bring their own.
    fn map_at(&self, _path: &str) -> Option<MapId> {
        None
    }

    /// Reads a map.
    fn read_map(&self, entry: &Entry, _reader: &mut dyn BufRead) -> Result<MapFile, Error> {
        Err(Error::map(&entry.path, "", "is of a scenario, and is read with it"))
    }

    /// The place that the path of a recording or a map names, whether or not it is one to keep.
    fn place_at(&self, _path: &str) -> Option<String> {
        None
    }

    /// The map that the recordings at `path` need, if the path names it, so that a missing map is reported before
    /// reading.
    fn map_of(&self, _path: &str) -> Option<MapId> {
        None
    }
}

/// A scene to be made, complete or a reject.
pub type PendingScene<'a> = Box<dyn FnOnce() -> Result<RawScene, Reject> + Send + 'a>;

/// A map as read from its file.
#[derive(Debug)]
pub struct MapFile {
    /// Its lanes.
    pub graph: LaneGraph,
    /// If several files contain one map, the one with the lowest rank counts; the first among equals.
    pub rank: u8,
    /// Its defects.
    pub report: MapReport,
}

/// Receives units and rejects; each counts as one unit. `Break` ends reading.
pub type EmitUnit<'a> = dyn FnMut(Result<RawUnit, Reject>) -> ControlFlow<()> + 'a;

/// Cuts entries into units. It may hold back a bounded amount of entries until their counterparts arrive.
pub trait UnitReader {
    /// Reads one entry.
    ///
    /// # Errors
    /// When it cannot continue with the configuration; an entry that cannot be read is a reject.
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error>;

    /// Whether to read all entries once more; called after the last one. A reader that must know a whole table before
    /// it emits any of it reads the table twice instead of holding it.
    fn next_pass(&mut self) -> bool {
        false
    }

    /// Emits the entries that are held back, after the last entry of the last pass.
    fn finish(&mut self, _emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        Ok(ControlFlow::Continue(()))
    }
}

/// Observed and future timesteps of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Horizon {
    /// Observed timesteps.
    pub n_history: usize,
    /// Future timesteps.
    pub n_future: usize,
}

impl Horizon {
    /// The configured horizon, or `default`.
    pub fn of(config: &IngestConfig, default: Self) -> Self {
        Self {
            n_history: config.n_history.unwrap_or(default.n_history),
            n_future: config.n_future.unwrap_or(default.n_future),
        }
    }

    /// The configured horizon for recordings of fixed length, whose present is fixed: it may only be shorter.
    ///
    /// # Errors
    /// [`Error::Config`] when it is longer than the recordings.
    pub fn within(config: &IngestConfig, recorded: Self) -> Result<Self, Error> {
        let horizon = Self::of(config, recorded);
        for (key, asked, has) in
            [("n_history", horizon.n_history, recorded.n_history), ("n_future", horizon.n_future, recorded.n_future)]
        {
            if asked > has {
                let detail = format!("is {asked}, but {} records only {has} timesteps", config.dataset.name());
                return Err(Error::Config { key: key.to_owned(), detail });
            }
        }
        Ok(horizon)
    }

    /// Number of timesteps.
    pub const fn n_timesteps(self) -> usize {
        self.n_history + self.n_future
    }

    /// The error for a recording of `n` timesteps, called `frames` in it, that is too short.
    pub fn too_long_for(self, n: i64, frames: &str) -> String {
        let n_timesteps = self.n_timesteps();
        format!("{n} {frames}, a scene has {n_timesteps}: set ingest.n_history and ingest.n_future for shorter scenes")
    }
}
