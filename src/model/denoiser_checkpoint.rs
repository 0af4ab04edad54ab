//! The description of a denoiser in its checkpoint, beside the weights.

use super::{ModelSpec, NetworkConfig, SceneDenoiser, SceneShape, TrainedModel};
use crate::diffusion::Edm;
use crate::nn::Params;
use crate::seed::Seed;
use crate::settings::named;
use crate::settings::{self, Issue};
use crate::tensor::{Collator, Normalizer, Sight};
use serde::{Deserialize, Deserializer, Serialize, de};

/// The specification of a denoiser, beside its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DenoiserSpec {
    /// Marks the file as a denoiser, for its readers.
    pub kind: DenoiserKind,
    /// The network.
    #[serde(deserialize_with = "network")]
    pub network: NetworkConfig,
    /// Constants of the diffusion.
    #[serde(with = "super::named_edm")]
    pub edm: Edm,
    /// Scales, from the training scenes.
    pub normalizer: Normalizer,
    /// Observed timesteps t_obs of the scenes it was trained on.
    pub n_history: usize,
    /// Timesteps T of the scenes it was trained on.
    pub n_timesteps: usize,
    /// Time between timesteps, seconds.
    pub dt_s: f64,
    /// Maximum number of agents per scene.
    pub max_agents: usize,
    /// Maximum number of lane polylines per scene.
    pub max_lanes: usize,
    /// Optimizer steps it was trained for.
    pub steps: u64,
    /// Seed it was trained with.
    pub seed: u64,
    /// Fingerprint of the scenes it was trained on.
    pub scenes: String,
    /// The objectives toward which it was trained, as in the configuration; for a distilled denoiser, those of its
    /// teacher come first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objectives: Vec<serde_json::Value>,
    /// Its loss on held-out scenes after changes to its inputs; empty if not measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changed_losses: Vec<ChangedLoss>,
    /// Its loss on held-out scenes place by place; empty if not measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub losses_by_place: Vec<PlaceLoss>,
    /// The target of its distillation; `None` for an ordinary denoiser.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distillation: Option<Distillation>,
}

/// Reads a network. Checkpoints of earlier builds, including the bundled ones, have a flag for a part that networks no
/// longer have, set to off.
fn network<'de, D: Deserializer<'de>>(from: D) -> Result<NetworkConfig, D::Error> {
    let mut network = serde_json::Value::deserialize(from)?;
    let geometry = network.get_mut("geometry").and_then(serde_json::Value::as_object_mut);
    match geometry.and_then(|geometry| geometry.remove("relative_attention")) {
        Some(serde_json::Value::Bool(true)) => {
            Err(de::Error::custom("network.geometry.relative_attention is true, which no network has any more"))
        }
        _ => NetworkConfig::deserialize(network).map_err(de::Error::custom),
    }
}

/// The loss of a denoiser on held-out scenes with a change made before it saw them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChangedLoss {
    /// The change.
    pub change: SceneChange,
    /// Noise level.
    pub sigma: f64,
    /// The loss.
    pub loss: f64,
}

/// The loss of a denoiser on the held-out scenes of a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceLoss {
    /// The place.
    pub place: String,
    /// Number of held-out scenes.
    pub n_scenes: u64,
    /// Noise level.
    pub sigma: f64,
    /// The loss.
    pub loss: f64,
    /// The loss with lanes turned by 90 degrees around the ego agent.
    pub map_turned: f64,
}

/// A change to a scene that a network that looks at its surroundings must notice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneChange {
    /// No change.
    AsRecorded,
    /// Lanes turned by 90 degrees around the ego agent.
    MapTurned,
    /// Lanes shifted by 4 m to the left of the ego agent.
    MapShifted,
    /// No lanes.
    NoMap,
    /// No change, but the loss of the ego agent's states only.
    EgoOnly,
    /// No agents but the ego agent, and the loss of its states only.
    EgoAlone,
}

named! { SceneChange {
    AsRecorded = "as_recorded", MapTurned = "map_turned", MapShifted = "map_shifted", NoMap = "no_map",
    EgoOnly = "ego_only", EgoAlone = "ego_alone",
} }

/// The target of a distillation, which decides how the denoiser is sampled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Distillation {
    /// Each output leads to the next of these noise levels in one Euler step.
    Steps {
        /// The noise levels at which it can be evaluated, and 0.
        sigmas: Vec<f64>,
    },
}

/// The one value of `DenoiserSpec::kind`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DenoiserKind {
    /// A DJINN denoiser.
    SceneDenoiser,
}

impl DenoiserSpec {
    /// How scenes become batches to train on.
    pub fn collator(&self) -> Collator {
        Collator {
            normalizer: self.normalizer.clone(),
            n_timesteps: self.n_timesteps,
            max_agents: self.max_agents,
            max_lanes: self.max_lanes,
            sight: self.network.geometry.as_ref().map(|geometry| Sight::new(geometry.n_lanes)),
        }
    }

    /// How scenes become batches to sample. The geometric network takes any number of agents, and none is left out: an
    /// agent that is left out ends with the past.
    pub fn sampling_collator(&self) -> Collator {
        let max_agents = if self.network.geometry.is_some() { usize::MAX } else { self.max_agents };
        Collator { max_agents, ..self.collator() }
    }
}

impl ModelSpec for DenoiserSpec {
    type Network = SceneDenoiser;

    fn shape(&self) -> SceneShape<'_> {
        let Self { normalizer, n_history, n_timesteps, dt_s, .. } = self;
        SceneShape { normalizer, n_history: *n_history, n_timesteps: *n_timesteps, dt_s: *dt_s }
    }

    fn check_network(&self) -> settings::Result {
        settings::check_ranges(&self.network).map_err(|issue| issue.within("network"))?;
        match self.max_agents {
            0 => Err(Issue::new("max_agents", "is 0, expected at least 1")),
            _ => Ok(()),
        }
    }

    fn build(&self, params: &mut Params, seed: Seed) -> candle_core::Result<SceneDenoiser> {
        SceneDenoiser::new(params, &self.network, self.normalizer.state_dim, self.edm, seed)
    }
}

/// A denoiser for sampling.
pub type TrainedDenoiser = TrainedModel<DenoiserSpec>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_that_is_gone_may_be_named_as_off_and_not_as_on() {
        let read = |geometry: &str| network(&mut serde_json::Deserializer::from_str(geometry));
        let whole =
            NetworkConfig { geometry: Some(crate::model::GeometryConfig::default()), ..NetworkConfig::default() };
        assert_eq!(read(r#"{"geometry":{"relative_attention":false}}"#).unwrap(), whole);
        for geometry in [r#"{"relative_attention":true}"#, r#"{"relative_attn":false}"#] {
            assert!(read(&format!(r#"{{"geometry":{geometry}}}"#)).unwrap_err().to_string().contains("relative_att"));
        }
    }
}
