//! A trained Scene Transformer on disk: weights, and everything needed to use them on scenes.

use super::{SceneTransformer, SceneTransformerConfig};
use crate::nn::{Error, Params, read_checkpoint, write_checkpoint};
use crate::seed::Seed;
use crate::tensor::{Collator, Normalizer};
use candle_core::Device;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a Scene Transformer is, beside its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneTransformerSpec {
    /// Says that this is a Scene Transformer, to readers of the file.
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
    /// At most so many agents a scene.
    pub max_agents: usize,
    /// At most so many lane polylines a scene.
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

/// A Scene Transformer for prediction, with what it is and where it came from.
#[derive(Debug, Clone)]
pub struct TrainedSceneTransformer {
    /// The network; its parameters take no gradients.
    pub network: SceneTransformer,
    /// What it is.
    pub spec: SceneTransformerSpec,
    /// Hash of its file.
    pub fingerprint: String,
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

    /// Writes the checkpoint file and returns its fingerprint.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn write(&self, params: &Params, path: &Path) -> Result<String, Error> {
        write_checkpoint(path, &params.tensors(), self)
    }
}

impl TrainedSceneTransformer {
    /// Reads a checkpoint file.
    ///
    /// # Errors
    /// When the file is not a whole Scene Transformer checkpoint of this version.
    pub fn read(path: &Path, device: &Device) -> Result<Self, Error> {
        let checkpoint = read_checkpoint::<SceneTransformerSpec>(path, device)?;
        let spec = checkpoint.metadata;
        let tensor_error = |source| Error::Tensor { path: path.to_owned(), source };
        let mut params = Params::new(device).frozen();
        let state_dim = spec.normalizer.state_dim;
        let parametrization = spec.normalizer.parametrization;
        let seed = Seed(spec.seed);
        let network = SceneTransformer::new(&mut params, &spec.network, state_dim, parametrization, seed)
            .map_err(tensor_error)?;
        params.load(&checkpoint.tensors).map_err(tensor_error)?;
        Ok(Self { network, spec, fingerprint: checkpoint.fingerprint })
    }
}
