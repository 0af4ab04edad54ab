//! A sweep as written: the settings of each kind of model, and nothing else. Its keys are those of `SweepKeys`.

use super::keys::SweepKeys;
use crate::diffusion::SamplerConfig;
use crate::generate::{ClassifierFreeConfig, EditConfig, ObserveConfig, PairSelectionConfig, SelectConfig};
use crate::guidance::{ClassifierPotential, GuidanceConfig, ObjectiveConfig, ObjectiveGuidanceConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[generate.sweeps]]`: every chosen scene, at every guidance level, `n_samples` times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "SweepKeys", into = "SweepKeys")]
pub struct SweepConfig {
    /// Name, unique among the sweeps.
    pub name: String,
    /// Number of scenes to continue.
    pub n_scenes: usize,
    /// Name of the mined behavior to request; `None`: scenes are continued without a request.
    pub behavior: Option<String>,
    /// Which agents are to show the behavior.
    pub pairs: PairSelectionConfig,
    /// Which events the samples aim at.
    pub aim: Aim,
    /// Which samples become scenarios; `None`: all.
    pub select: Option<SelectConfig>,
    /// Start no further shards once this many scenarios are verified; `None`: generate all.
    pub stop_after_verified: Option<usize>,
    /// How samples are drawn.
    pub sampling: SamplingConfig,
}

/// `[[generate.arms]]`: a way of sampling that requests may try. The request decides on scenes, pairs and behavior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "SweepKeys", into = "SweepKeys")]
#[schemars(transform = super::keys::without_keys_of_requests)]
pub struct ArmConfig {
    /// Name, unique among the arms.
    pub name: String,
    /// How samples are drawn.
    pub sampling: SamplingConfig,
}

/// How samples are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SamplingConfig {
    /// Samples of each scene at each level.
    pub n_samples: usize,
    /// Which states are observed; the rest is generated.
    pub observe: ObserveConfig,
    /// The model with its settings.
    pub model: ModelConfig,
}

/// Which model samples come from.
#[derive(Debug, Clone, PartialEq)]
pub enum ModelConfig {
    /// The denoiser: samples are independent draws, in any number.
    Denoiser(DiffusionConfig),
    /// The denoiser of `[train.distill]`, in few evaluations.
    Distilled(DiffusionConfig),
    /// Scene Transformer of `[train.baseline]`: samples are its joint futures. It predicts in one pass, so there is
    /// nothing to guide or edit.
    Baseline,
}

/// How a denoiser is sampled.
#[derive(Debug, Clone, PartialEq)]
pub struct DiffusionConfig {
    /// How noise becomes a sample; `None`: as in the other sweeps.
    pub sampler: Option<SamplerConfig>,
    /// How strongly samples are kept apart and on the road; `None`: as in the other sweeps.
    pub validity_strength: Option<f64>,
    /// Strengths α of guidance, each of them sampled; 0 is unguided.
    pub strengths: Vec<f64>,
    /// What guides.
    pub guidance: SweepGuidance,
    /// States that samples lean toward.
    pub classifier_free: Option<ClassifierFreeConfig>,
    /// Edits of the recording that samples start from.
    pub edit: Option<EditConfig>,
    /// Whether the requested agents follow a template of the behavior.
    pub template: bool,
}

/// What guides samples, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepGuidance {
    /// When guidance acts and how far it may go.
    pub gate: GuidanceConfig,
    /// Which agents the classifier of the behavior judges.
    pub classifier_scope: ClassifierScope,
    /// What the classifier is shown.
    pub classifier_input: ClassifierInput,
    /// What of the classifier is made large.
    pub classifier_potential: ClassifierPotential,
    /// Objectives for the trajectories, in addition to a behavior or instead of one.
    pub objectives: Vec<ObjectiveConfig>,
    /// How objectives become shifts of the clean estimate.
    pub objective_guidance: ObjectiveGuidanceConfig,
}

/// Which agents the classifier of the behavior judges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierScope {
    /// The requested pair: chosen beforehand, and verified.
    #[default]
    Pair,
    /// None: only objectives guide. Pairs are chosen and verified as with `pair`.
    None,
}

/// What the classifier of a behavior is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierInput {
    /// The diffused states of the pair with their noise, at every noise level (paper, section 5.2).
    #[default]
    NoisyStates,
    /// The denoiser's estimate of the pair's future, as objectives see it.
    CleanEstimate,
}

/// Which events guided samples aim at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Aim {
    /// As the objectives say themselves.
    #[default]
    Anything,
    /// Each sample aims at a different outcome that its pair can still reach, given its past and the limits of driving;
    /// easy outcomes come more often. Samples of a pair then differ in parameters such as gap and relative speed.
    Feasible,
}
