//! The description of a behavior classifier in its checkpoint, beside the weights.

use super::{BehaviorClassifier, BehaviorClassifierConfig, ModelSpec, SceneShape, TrainedModel};
use crate::diffusion::Edm;
use crate::nn::Params;
use crate::seed::Seed;
use crate::tensor::{Normalizer, PairFeatures, SceneBatch};
use candle_core::Result;
use serde::{Deserialize, Serialize};

/// The specification of a classifier, beside its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassifierSpec {
    /// Marks the file as a behavior classifier, for its readers.
    pub kind: ClassifierKind,
    /// Name of the behavior.
    pub behavior: String,
    /// The roles of the pair: one or two, in the behavior's order.
    pub roles: Vec<String>,
    /// Shape of the network.
    pub network: BehaviorClassifierConfig,
    /// Constants of the diffusion.
    #[serde(with = "super::named_edm")]
    pub edm: Edm,
    /// Scales: those of the denoiser that the classifier guides, which must be the same.
    pub normalizer: Normalizer,
    /// Observed timesteps t_obs of the scenes it was trained on.
    pub n_history: usize,
    /// Timesteps T of the scenes it was trained on.
    pub n_timesteps: usize,
    /// Time between timesteps, seconds.
    pub dt_s: f64,
    /// Number of positive pairs it was trained on.
    pub n_positive: u64,
    /// Number of negative pairs it was trained on.
    pub n_negative: u64,
    /// The weight of a positive pair in the loss relative to a negative one.
    pub pos_weight: f64,
    /// Optimizer steps it was trained for.
    pub steps: u64,
    /// Seed it was trained with.
    pub seed: u64,
    /// Fingerprint of the events it was trained on.
    pub events: String,
}

/// The one value of `ClassifierSpec::kind`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierKind {
    /// A classifier of the behavior of agents.
    BehaviorClassifier,
}

impl ClassifierSpec {
    /// The classifier's input for agents `pairs[b]` = (first, second) of row b, as places on the batch's agent axis.
    ///
    /// # Errors
    /// Fails when there is not one pair per row or a place lies outside the agent axis.
    pub fn features(&self, batch: &SceneBatch, pairs: &[(usize, usize)]) -> Result<PairFeatures> {
        PairFeatures::new(batch, pairs, self.normalizer.parametrization)
    }
}

impl ModelSpec for ClassifierSpec {
    type Network = BehaviorClassifier;

    fn shape(&self) -> SceneShape<'_> {
        let Self { normalizer, n_history, n_timesteps, dt_s, .. } = self;
        SceneShape { normalizer, n_history: *n_history, n_timesteps: *n_timesteps, dt_s: *dt_s }
    }

    fn build(&self, params: &mut Params, seed: Seed) -> Result<BehaviorClassifier> {
        let state_dim = self.normalizer.state_dim;
        BehaviorClassifier::new(params, &self.network, self.n_timesteps, state_dim, self.edm, seed)
    }
}

/// A classifier for guidance.
pub type TrainedClassifier = TrainedModel<ClassifierSpec>;
