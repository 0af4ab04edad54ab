//! The judgment of a generated scenario: could it have happened, how critical is it, is it new?

use crate::behavior::Explanation;
use crate::metrics::{CarefulJudgment, Ending, PairCriticality, SceneCriticality, Violation};
use crate::rates::BucketRate;
use serde::{Deserialize, Serialize};

/// The judgment of one scenario, independent of its guidance. Undefined parts are absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Assessment {
    /// Whether it is verified, valid and no near-duplicate.
    pub accepted: bool,
    /// The validity checks that it fails, each with its worst place.
    pub violations: Vec<Violation>,
    /// Share of its motion within the recorded ranges.
    pub plausibility: Option<f64>,
    /// Probability that its tracks were recorded, for a classifier that has not seen its scene.
    pub recorded_likeness: Option<f64>,
    /// How critical the encounter of the requested agents is.
    pub pair: Option<PairCriticality>,
    /// How critical the worst encounter of any two agents is.
    pub scene: Option<SceneCriticality>,
    /// What the careful driver makes of it in place of the subject, if the event comes from another agent.
    pub careful: Option<CarefulJudgment>,
    /// The ending for the subject of the requested event; `None` also if a collision was requested.
    pub ending: Option<Ending>,
    /// Why its event happens, if it is one that needs a cause and has one.
    pub explanation: Option<Explanation>,
    /// Distance of its event from the nearest recorded one, in typical spreads.
    pub nearest_recorded_event: Option<f64>,
    /// Distance of its requested agents' paths from those of the nearest earlier accepted scenario, meters.
    pub nearest_scenario_m: Option<f64>,
    /// The id of that scenario if the two are near-duplicates.
    pub near_duplicate_of: Option<String>,
    /// How often events like its were recorded; `None` without a verified event, or if nothing was counted.
    pub rate: Option<BucketRate>,
}

impl Assessment {
    /// Whether it passes every validity check.
    pub const fn is_valid(&self) -> bool {
        self.violations.is_empty()
    }
}
