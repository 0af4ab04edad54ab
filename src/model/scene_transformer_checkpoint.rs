//! The description of a Scene Transformer in its checkpoint, beside the weights.

use super::{ModelSpec, SceneShape, SceneTransformer, SceneTransformerConfig, TrainedModel};
use crate::nn::Params;
use crate::seed::Seed;
use crate::tensor::{Collator, Normalizer};
use serde::{Deserialize, Serialize};

/// The specification of a Scene Transformer, beside its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneTransformerSpec {
    /// Marks the file as a Scene Transformer, for its readers.
    pub kind: SceneTransformerKind,
    /// The network.
    pub network: SceneTransformerConfig,
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
}

/// The one value of `SceneTransformerSpec::kind`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneTransformerKind {
    /// A Scene Transformer, joint variant.
    SceneTransformer,
}

impl SceneTransformerSpec {
    /// How scenes become batches for this network.
    pub fn collator(&self) -> Collator {
        Collator {
            normalizer: self.normalizer.clone(),
            n_timesteps: self.n_timesteps,
            max_agents: self.max_agents,
            max_lanes: self.max_lanes,
            sight: None,
        }
    }
}

impl ModelSpec for SceneTransformerSpec {
    type Network = SceneTransformer;

    fn shape(&self) -> SceneShape<'_> {
        let Self { normalizer, n_history, n_timesteps, dt_s, .. } = self;
        SceneShape { normalizer, n_history: *n_history, n_timesteps: *n_timesteps, dt_s: *dt_s }
    }

    fn build(&self, params: &mut Params, seed: Seed) -> candle_core::Result<SceneTransformer> {
        let Normalizer { state_dim, parametrization, .. } = self.normalizer;
        SceneTransformer::new(params, &self.network, state_dim, parametrization, seed)
    }
}

/// A Scene Transformer for prediction.
pub type TrainedSceneTransformer = TrainedModel<SceneTransformerSpec>;
