//! The main figures of an evaluation.

use super::distinguishability::{DistinguishabilityRow, TellingFeatureRow};
use super::map_fits::MapFitRow;
use super::measures::MetricDoc;
use super::sampling::SamplingRow;
use super::validity::ValidityRow;
use super::verdicts::{AcceptanceRow, LeftOutRow};
use crate::metrics::MetricRow;
use crate::rates::Calibration;
use serde::{Deserialize, Serialize};

/// The main figures of an evaluation: the content of `metrics.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSummary {
    /// Number of generated scenarios.
    pub n_scenarios: u64,
    /// The number that show the requested behavior.
    pub n_verified: u64,
    /// The number of verified ones whose recording does not already show the behavior.
    pub n_new: u64,
    /// The number that pass every check of validity.
    pub n_valid: u64,
    /// The number of accepted ones: verified, valid and no near-duplicates.
    pub n_accepted: u64,
    /// The number of scenarios in the corpus.
    pub n_kept: u64,
    /// The gates.
    pub gates: Vec<GateResult>,
    /// Requested and generated scenarios, by sweep, place and strength.
    pub sampling: Vec<SamplingRow>,
    /// Definitions of the metrics.
    pub docs: Vec<MetricDoc>,
    /// Means over scenes: of all places together, then of each.
    pub aggregates: Vec<MetricRow>,
    /// The verdicts on the scenarios of each sweep at each strength.
    pub acceptance: Vec<AcceptanceRow>,
    /// Why samples are not accepted, or not even scenarios.
    pub left_out: Vec<LeftOutRow>,
    /// How many scenarios, and how many of the recordings that they continue, fail each check.
    pub validity: Vec<ValidityRow>,
    /// The performance of a classifier that tells the tracks of each series from recorded ones.
    pub distinguishability: Vec<DistinguishabilityRow>,
    /// The features that give generated tracks away.
    pub telling_features: Vec<TellingFeatureRow>,
    /// The places where the map is good enough to judge departures from the road.
    pub maps: Vec<MapFitRow>,
    /// Modeled against recorded rates, if there are modeled ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Vec<Calibration>>,
}

/// A gate and whether it was met.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GateResult {
    /// The name of the gate, with the series: `min_validity_rate (cut_ins, α = 2)`.
    pub gate: String,
    /// Whether it was met.
    pub met: bool,
    /// The requirement and the value found, or why it cannot be judged.
    pub detail: String,
}
