//! How and from where is a corpus driven?

use super::{EgoDriver, Error, Result};
use crate::export::Selection;
use crate::generate::{Futures, NamedDriver};
use crate::simulate::{RatesConfig, RolloutConfig, World};
use std::path::PathBuf;
use std::str::FromStr;

/// How a corpus is driven.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveConfig {
    /// The driver of the ego.
    pub ego: EgoDriver,
    /// The settings of each drive.
    pub rollout: RolloutConfig,
    /// The time limit for an answer of a planner, seconds.
    pub time_limit_s: f64,
    /// When to save the state of each drive.
    pub save_at: Option<SaveAt>,
    /// Whether to find how much later the others of each event could be.
    pub bisects: bool,
    /// Whether to find how often the driver would fail on the roads of the corpus.
    pub rates: bool,
    /// Loops from recorded scenes, split, to find the same without buckets.
    pub split: Option<RatesConfig>,
    /// Scenarios driven at the same time, each with a planner of its own.
    pub n_workers: usize,
    /// The version of the program: drives of another one are not reused.
    pub program: String,
    /// The folder of ingested scenes that tell the arrivals in recordings; without it, the corpus does.
    pub scenes: Option<PathBuf>,
}

impl DriveConfig {
    /// Rejects settings with which this model cannot drive.
    pub(super) fn check(&self, futures: &Futures<'_>) -> Result<()> {
        self.rollout.check(futures)?;
        if self.split.is_some() && self.scenes.is_none() {
            let why = "loops begin with recorded scenes: name their folder with --scenes";
            return Err(Error::Config(why.to_owned()));
        }
        if self.ego.name().trim().is_empty() {
            let names = NamedDriver::ALL.map(NamedDriver::name).join(", ");
            return Err(Error::Config(format!("--ego is empty, expected {names} or the command of a planner")));
        }
        if !(self.time_limit_s > 0.0 && self.time_limit_s <= 3600.0) {
            let limit_s = self.time_limit_s;
            return Err(Error::Config(format!("time_limit_s is {limit_s:?}, expected more than 0 and at most 3600 s")));
        }
        Ok(())
    }
}

/// When to save the state of a drive: at the first replanning at or after this.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SaveAt {
    /// The beginning of the event.
    Event,
    /// A timestep, from the beginning of the past.
    Timestep(usize),
}

impl FromStr for SaveAt {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "event" => Ok(Self::Event),
            number => number.parse().map(Self::Timestep).map_err(|_| "expected event or a timestep".to_owned()),
        }
    }
}

/// Where to drive from.
#[derive(Debug)]
pub enum Origin<'a> {
    /// The present of the scenarios of this selection.
    Scenarios(&'a Selection),
    /// A saved state.
    State(World),
}
