//! The `[evaluate]` section: what is measured, what is kept, what must hold.

use super::measures::known_ids;
use crate::pipeline::{Failure, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is measured, what is kept and what must hold.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluateConfig {
    /// The metrics, by name; empty: all.
    pub metrics: Vec<String>,
    /// Which scenarios become the corpus.
    pub keep: Keep,
    /// What must hold; the program ends with exit code 3 where it does not.
    pub gates: GatesConfig,
}

/// Which scenarios become the corpus.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// Those in which the behavior that was asked for is found.
    #[default]
    Verified,
    /// All.
    All,
}

/// Bounds that the results must keep. What is left out is not checked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GatesConfig {
    /// At least so many scenarios, over all sweeps, hold the behavior that was asked for.
    pub min_verified: Option<u64>,
    /// At least so many of them where the recording does not hold it for the same agents.
    pub min_new: Option<u64>,
    /// Largest collision rate of any sweep at any strength.
    pub max_collision_rate: Option<f64>,
    /// Largest off-road rate of any sweep at any strength.
    pub max_offroad_rate: Option<f64>,
    /// Whether unguided samples must be closer to the recording than a constant velocity, by minSceneADE, in every sweep.
    pub beat_constant_velocity: bool,
    /// Whether in every sweep that asks for a behavior the strongest guidance must find it more often than strength 0.
    pub guidance_raises_rate: bool,
}

impl EvaluateConfig {
    /// Refuses metrics that there are not.
    pub(super) fn validate(&self) -> Result<()> {
        let known = known_ids();
        let Some(unknown) = self.metrics.iter().find(|name| !known.contains(&name.as_str())) else { return Ok(()) };
        let message = format!("evaluate.metrics: there is no metric {unknown}; known: {}", known.join(", "));
        let nearest = known.iter().min_by_key(|name| strsim::damerau_levenshtein(unknown, name));
        let failure = Failure::input_message(message);
        Err(match nearest {
            Some(nearest) => failure.with_hint(format!("did you mean `{nearest}`?")),
            None => failure,
        })
    }
}
