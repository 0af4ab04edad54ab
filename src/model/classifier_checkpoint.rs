//! What the checkpoint of a behavior classifier says, beside the weights.

use super::{BehaviorClassifier, BehaviorClassifierConfig, FutureClassifier, ModelSpec, TrainedModel};
use crate::diffusion::Edm;
use crate::nn::Params;
use crate::seed::Seed;
use crate::tensor::{Normalizer, PairFeatures, SceneBatch};
use candle_core::{Result, bail};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a classifier is, beside its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassifierSpec {
    /// Says that this is a behavior classifier, to readers of the file.
    pub kind: ClassifierKind,
    /// What it sees. Checkpoints of classifiers of noisy states do not say it.
    #[serde(default, skip_serializing_if = "ClassifierInput::is_noisy")]
    pub input: ClassifierInput,
    /// Name of the behavior.
    pub behavior: String,
    /// The roles of the pair: one or two, in the behavior's order.
    pub roles: Vec<String>,
    /// Shape of the network.
    pub network: BehaviorClassifierConfig,
    /// Constants of the diffusion.
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
    /// How much more a positive pair counted in the loss than a negative one.
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

/// What a classifier of a behavior sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierInput {
    /// The diffused states of the pair with their noise, at every noise level (paper, section 5.2).
    #[default]
    NoisyStates,
    /// The pair's clean future: in sampling the denoiser's estimate of it, in meters, as objectives see it.
    CleanEstimate,
}

impl ClassifierInput {
    /// Whether these are the paper's noisy states, which files need not name.
    pub const fn is_noisy(&self) -> bool {
        matches!(self, Self::NoisyStates)
    }
}

/// The network of a classifier.
#[derive(Debug, Clone)]
pub enum ClassifierNetwork {
    /// Of noisy states.
    NoisyStates(BehaviorClassifier),
    /// Of clean futures.
    CleanEstimate(FutureClassifier),
}

impl ClassifierNetwork {
    /// The classifier of noisy states.
    ///
    /// # Errors
    /// When it sees clean futures.
    pub fn of_noisy_states(&self) -> Result<&BehaviorClassifier> {
        match self {
            Self::NoisyStates(classifier) => Ok(classifier),
            Self::CleanEstimate(_) => bail!("the classifier was trained on clean estimates, not on noisy states"),
        }
    }

    /// The classifier of clean futures.
    ///
    /// # Errors
    /// When it sees noisy states.
    pub fn of_clean_futures(&self) -> Result<&FutureClassifier> {
        match self {
            Self::CleanEstimate(classifier) => Ok(classifier),
            Self::NoisyStates(_) => bail!("the classifier was trained on noisy states, not on clean estimates"),
        }
    }
}

impl ClassifierSpec {
    /// What a classifier of noisy states sees of agents `pairs[b]` = (first, second) of row b, as places on the batch's agent axis.
    ///
    /// # Errors
    /// Fails when there is not one pair a row or a place lies outside the agent axis.
    pub fn features(&self, batch: &SceneBatch, pairs: &[(usize, usize)]) -> Result<PairFeatures> {
        PairFeatures::new(batch, pairs, self.normalizer.parametrization, self.edm.sigma_data)
    }
}

impl ModelSpec for ClassifierSpec {
    type Network = ClassifierNetwork;

    fn build(&self, params: &mut Params, seed: Seed) -> Result<ClassifierNetwork> {
        let (network, state_dim) = (&self.network, self.normalizer.state_dim);
        Ok(match self.input {
            ClassifierInput::NoisyStates => {
                let classifier = BehaviorClassifier::new(params, network, self.n_timesteps, state_dim, self.edm, seed)?;
                ClassifierNetwork::NoisyStates(classifier)
            }
            ClassifierInput::CleanEstimate => {
                ClassifierNetwork::CleanEstimate(FutureClassifier::new(params, network, seed)?)
            }
        })
    }
}

/// A classifier for guidance.
pub type TrainedClassifier = TrainedModel<ClassifierSpec>;
