//! The settings of gates, and whether what is measured and generated can decide them.

use super::error::{Error, Result};
use crate::generate::{ResolvedGeneration, ResolvedSweep};
use crate::scene::LevelAxis;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Bounds for the results. Gates that are left out are not checked. A gate that cannot be judged, because nothing was
/// measured for it, fails.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GatesConfig {
    /// Minimum number of verified scenarios over all sweeps.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_verified: Option<u64>,
    /// Minimum number of verified scenarios whose recording does not show the behavior for the same agents.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_new: Option<u64>,
    /// Minimum number of accepted scenarios over all sweeps: verified, valid and no near-duplicates.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_accepted: Option<u64>,
    /// Smallest share of valid scenarios of any sweep at any strength, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_validity_rate: Option<f64>,
    /// Largest collision rate of any sweep at any strength, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_collision_rate: Option<f64>,
    /// Largest off-road rate of any sweep at any strength, 0 to 1. Needs maps.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_offroad_rate: Option<f64>,
    /// Largest share of pairs, one recorded and one generated track of any sweep at any strength, of which a classifier
    /// that sees all features picks the generated one, .5 to 1. 0.5 is indistinguishable.
    #[schemars(range(min = 0.5, max = 1.0))]
    pub max_distinguishability: Option<f64>,
    /// Whether unguided samples must be closer to the recording than a constant velocity, by minSceneADE, in every
    /// sweep that has some; at least one must.
    pub beat_constant_velocity: bool,
    /// Whether in every sweep that requests a behavior at several strengths the strongest must find it more often than
    /// strength 0; at least one must.
    pub guidance_raises_rate: bool,
}

/// A bound on the mean of a metric, for every series.
#[derive(Clone, Copy)]
pub(super) struct RateGate {
    pub(super) name: &'static str,
    pub(super) metric: &'static str,
    pub(super) bound: Option<f64>,
    pub(super) is_least: bool,
}

impl GatesConfig {
    pub(super) fn rates(&self) -> [RateGate; 3] {
        let gate = |name, metric, bound, is_least| RateGate { name, metric, bound, is_least };
        [
            gate("max_collision_rate", "collision_rate", self.max_collision_rate, false),
            gate("max_offroad_rate", "offroad_rate", self.max_offroad_rate, false),
            gate("min_validity_rate", "validity_rate", self.min_validity_rate, true),
        ]
    }

    /// Refuses gates by metrics that are not among those `measured` (empty: all).
    ///
    /// # Errors
    /// [`Error::Config`] with the gate.
    pub(super) fn validate(&self, measured: &[String]) -> Result<()> {
        let by_rates =
            self.rates().into_iter().filter(|rate| rate.bound.is_some()).map(|rate| (rate.name, rate.metric));
        let by_displacement = self.beat_constant_velocity.then_some(("beat_constant_velocity", "min_scene_ade_m"));
        for (name, metric) in by_rates.chain(by_displacement) {
            if !measured.is_empty() && !measured.iter().any(|id| id == metric) {
                let why = format_args!("needs {metric}; add it to evaluate.metrics");
                return Err(refusal(name, why));
            }
        }
        Ok(())
    }

    /// Refuses gates that the generated samples cannot decide.
    ///
    /// # Errors
    /// [`Error::Config`] with the gate and the sweep.
    pub fn check_generated(&self, generated: &ResolvedGeneration, has_maps: bool) -> Result<()> {
        if self.max_offroad_rate.is_some() && !has_maps {
            return Err(refusal(
                "max_offroad_rate",
                "is set, but ingest.maps = \"none\" leaves no roads to judge by; ingest with maps",
            ));
        }
        let sweeps = &generated.sweeps;
        if self.beat_constant_velocity && !sweeps.iter().any(ResolvedSweep::has_unguided) {
            let why = "is set, but no sweep has unguided samples; add 0.0 to the strengths of a sweep without edits";
            return Err(refusal("beat_constant_velocity", why));
        }
        if self.guidance_raises_rate {
            let mut compared = sweeps.iter().filter(|sweep| sweep.behavior.is_some() && sweep.levels().len() > 1);
            let has_zero = |sweep: &&ResolvedSweep| {
                let axis = LevelAxis::of(sweep.levels().iter().copied());
                sweep.levels().iter().any(|level| axis.read(*level) == 0.0)
            };
            let without_zero = compared.clone().find(|sweep| !has_zero(sweep));
            if let Some(ResolvedSweep { name, .. }) = without_zero {
                let why =
                    format!("is set, but sweep {name} has no strength 0 to compare with; add 0.0 to its strengths");
                return Err(refusal("guidance_raises_rate", why));
            }
            if compared.next().is_none() {
                let why =
                    "is set, but no sweep requests a behavior at several strengths, such as strengths = [0.0, 10.0]";
                return Err(refusal("guidance_raises_rate", why));
            }
        }
        Ok(())
    }
}

fn refusal(gate: &str, why: impl fmt::Display) -> Error {
    let message = format!("evaluate.gates.{gate} {why}");
    Error::Config { message, advice: "or leave the gate out".to_owned() }
}
