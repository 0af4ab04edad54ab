//! What was judged of a scenario, independently of what guided it: could it have happened, how critical is it, is it new?

use crate::metrics::{CutInJudgment, PairCriticality, SceneCriticality, Violation};
use serde::{Deserialize, Serialize};

/// The judgment of one scenario. Parts that are not defined for it are absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Assessment {
    /// Whether it is verified, valid and no near-duplicate.
    pub accepted: bool,
    /// The checks of validity that it fails, each with its worst place.
    pub violations: Vec<Violation>,
    /// Share of its motion within the recorded ranges.
    pub plausibility: Option<f64>,
    /// How critical the encounter of the two is that were asked.
    pub pair: Option<PairCriticality>,
    /// How critical the worst encounter of any two is.
    pub scene: Option<SceneCriticality>,
    /// What UN Regulation No. 157 says of the cut-in that was asked for.
    pub cut_in: Option<CutInJudgment>,
    /// Distance of its event from the nearest recorded one, in typical spreads.
    pub nearest_recorded_event: Option<f64>,
    /// Distance of the paths of those who were asked from the nearest accepted scenario before it, meters.
    pub nearest_scenario_m: Option<f64>,
    /// That scenario, where it is too near to be another one.
    pub near_duplicate_of: Option<String>,
}

impl Assessment {
    /// Whether it passes every check of validity.
    pub const fn is_valid(&self) -> bool {
        self.violations.is_empty()
    }
}
