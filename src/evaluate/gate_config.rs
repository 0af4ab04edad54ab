//! The settings of gates, and whether they can be decided by what is measured and generated.

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
    /// Minimum number of verified scenarios whose recording does not show the behavior for the same agents.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_new: Option<u64>,
    /// Minimum number of accepted scenarios over all sweeps: verified, valid and no near-duplicates.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_accepted: Option<u64>,
    /// Smallest share of valid scenarios of any sweep at any strength, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_validity_rate: Option<f64>,
    /// Smallest share of the scenarios that a request wants, of each request, 0 to 1: 1 means that all are filled.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_filled: Option<f64>,
    /// Largest factor between modeled and recorded rates, at least 1, of any behavior with ten recorded events at its
    /// place.
    #[schemars(range(min = 1.0))]
    pub max_rate_factor: Option<f64>,
    /// Whether in every sweep that requests a behavior at several strengths the strongest must find it more often than
    /// strength 0; at least one must.
    pub guidance_raises_rate: bool,
}

impl GatesConfig {
    /// Refuses gates that the generated samples cannot decide.
    ///
    /// # Errors
    /// [`Error::Config`] with the gate and the sweep.
    pub fn check_generated(&self, generated: &ResolvedGeneration) -> Result<()> {
        let sweeps = &generated.sweeps;
        if self.min_filled.is_some() && generated.requests.is_empty() {
            return Err(refusal("min_filled", "is set, but there is no [[generate.requests]]"));
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
