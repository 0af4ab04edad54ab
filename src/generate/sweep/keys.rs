//! The keys of sweeps and arms in TOML: one flat table.
//!
//! Serde reads the flat table, so it can report the line of a mistake, which it cannot for tagged or flattened types.
//! Each kind of sweep then takes the keys that it knows; the remaining keys are refused.

use super::config::{
    Aim, ArmConfig, ClassifierScope, DiffusionConfig, ModelConfig, SamplingConfig, SweepConfig, SweepGuidance,
};
use crate::diffusion::SamplerConfig;
use crate::generate::{ClassifierFreeConfig, EditConfig, ObserveConfig, PairSelectionConfig, SelectConfig};
use crate::guidance::{
    ClassifierPotential, GuidanceConfig, NoiseOptimizationConfig, ObjectiveConfig, ObjectiveGuidanceConfig,
    ParticleConfig,
};
use crate::model::ClassifierInput;
use crate::settings::{Issue, Result};
use schemars::{JsonSchema, Schema};
use serde::{Deserialize, Serialize};

/// Keys that an arm does not have, because the request that names the arm decides them.
const OF_REQUESTS: [&str; 6] = ["n_scenes", "behavior", "pairs", "aim", "select", "stop_after_verified"];

/// A sweep or an arm as TOML has it.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SweepKeys {
    /// Name, unique among the sweeps or arms.
    name: String,
    /// Where samples come from: `denoiser`, `distilled` (few evaluations), or `baseline`. The baseline has at most as
    /// many samples as joint futures; of the keys about sampling it accepts only `n_samples` and `observe`.
    #[serde(default)]
    model: ModelKey,
    /// Number of scenes to continue.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = 1_000_000_000))]
    n_scenes: Option<usize>,
    /// How noise becomes a sample. Left out: as in the other sweeps.
    #[serde(skip_serializing_if = "Option::is_none")]
    sampler: Option<SamplerConfig>,
    /// Number of samples of each scene at each strength. Left out: 6.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 100_000))]
    n_samples: Option<usize>,
    /// Name of the mined behavior to request. Left out: scenes are continued without a request.
    #[serde(skip_serializing_if = "Option::is_none")]
    behavior: Option<String>,
    /// Strengths α of guidance, which multiply classifier and objectives alike; 0 is unguided sampling of the same scenes, pairs
    /// and noise, for comparison. `validity_strength` acts at all of them. Left out: 0 alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    strengths: Option<Vec<f64>>,
    /// When guidance acts and how far it may go.
    #[serde(skip_serializing_if = "Option::is_none")]
    guidance: Option<GuidanceConfig>,
    /// Which agents the classifier of the behavior judges.
    #[serde(skip_serializing_if = "Option::is_none")]
    classifier_scope: Option<ClassifierScope>,
    /// What the classifier of the behavior is shown. One that was trained on noisy states can be shown clean estimates,
    /// as objectives are, but not the other way around. Needed if more than the history is observed (`observe`): no classifier
    /// was trained on noisy states under other masks. `objective_guidance` says how the gradient at an estimate becomes a
    /// shift.
    #[serde(skip_serializing_if = "Option::is_none")]
    classifier_input: Option<ClassifierInput>,
    /// What of the classifier is made large.
    #[serde(skip_serializing_if = "Option::is_none")]
    classifier_potential: Option<ClassifierPotential>,
    /// Objectives for the trajectories, in addition to a behavior or instead of one.
    #[serde(skip_serializing_if = "Option::is_none")]
    objectives: Option<Vec<ObjectiveConfig>>,
    /// How strongly samples are kept apart and on the road, at every guidance strength. Left out: as in the other
    /// sweeps. Use 0 for raw samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    validity_strength: Option<f64>,
    /// How objectives become shifts of the clean estimate.
    #[serde(skip_serializing_if = "Option::is_none")]
    objective_guidance: Option<ObjectiveGuidanceConfig>,
    /// Groups of samples of a pair that are resampled by the objectives on the way, at every guidance strength: those
    /// with promising estimates go on several times. Needs a sampler that adds noise, such as `dpmpp_2m` with `eta`. It
    /// costs no evaluations of the network. Left out: each sample stands alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    particles: Option<ParticleConfig>,
    /// The noise that samples start from is moved toward better values of the objectives and the rules of traffic, by
    /// gradients through all steps of the sampler, which must be `euler` with few steps. Left out: it is random.
    #[serde(skip_serializing_if = "Option::is_none")]
    noise_optimization: Option<NoiseOptimizationConfig>,
    /// Which agents are to show the behavior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pairs: Option<PairSelectionConfig>,
    /// Which events guided samples aim at.
    #[serde(skip_serializing_if = "Option::is_none")]
    aim: Option<Aim>,
    /// Which states are observed: the name of a training task (`predictive`, `goal_conditioned`, `agent_conditioned`,
    /// `ego_conditioned`, `windowed`, `upsampling`, `imputation`), or a list of rules. The rest is generated. Left out: `predictive`.
    #[serde(skip_serializing_if = "Option::is_none")]
    observe: Option<ObserveConfig>,
    /// States that samples lean toward, by classifier-free guidance.
    #[serde(skip_serializing_if = "Option::is_none")]
    classifier_free: Option<ClassifierFreeConfig>,
    /// Edits of the recording that samples start from.
    #[serde(skip_serializing_if = "Option::is_none")]
    edit: Option<EditConfig>,
    /// Whether the agents of the event follow a template: a maneuver along the lanes that is solved for the sample's
    /// target. The denoiser observes all of it and samples everybody else. If no maneuver reaches the target, the
    /// sample follows another one; if there is none at all, it is sampled freely. Every behavior but
    /// `cut_in_paper` has templates. Left out: false.
    #[serde(skip_serializing_if = "Option::is_none")]
    template: Option<bool>,
    /// Which samples become scenarios. Left out: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    select: Option<SelectConfig>,
    /// Start no further shards of this sweep once this many of its scenarios are verified. Left out: generate all.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    stop_after_verified: Option<usize>,
}

/// Which model the samples of a sweep come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum ModelKey {
    /// The denoiser: samples are independent draws, in any number.
    #[default]
    Denoiser,
    /// The denoiser of `[train.distill]`, in few evaluations: with `sampler = { kind = "euler" }` and the `n_steps` and `grid` of
    /// `train.distill.method`, or `{ kind = "consistency", sigma_max = 24, levels = [4.0] }` for a consistency model.
    Distilled,
    /// Scene Transformer of `[train.baseline]`: samples are its joint futures, the most likely first, with their
    /// probabilities.
    Baseline,
}

impl SweepKeys {
    fn take_sampling(&mut self) -> SamplingConfig {
        SamplingConfig {
            n_samples: self.n_samples.take().unwrap_or(6),
            observe: self.observe.take().unwrap_or_default(),
            model: match self.model {
                ModelKey::Denoiser => ModelConfig::Denoiser(self.take_diffusion()),
                ModelKey::Distilled => ModelConfig::Distilled(self.take_diffusion()),
                ModelKey::Baseline => ModelConfig::Baseline,
            },
        }
    }

    fn take_diffusion(&mut self) -> DiffusionConfig {
        DiffusionConfig {
            sampler: self.sampler.take(),
            validity_strength: self.validity_strength.take(),
            strengths: self.strengths.take().unwrap_or_else(|| vec![0.0]),
            guidance: SweepGuidance {
                gate: self.guidance.take().unwrap_or_default(),
                classifier_scope: self.classifier_scope.take().unwrap_or_default(),
                classifier_input: self.classifier_input.take().unwrap_or_default(),
                classifier_potential: self.classifier_potential.take().unwrap_or_default(),
                objectives: self.objectives.take().unwrap_or_default(),
                objective_guidance: self.objective_guidance.take().unwrap_or_default(),
            },
            particles: self.particles.take(),
            noise_optimization: self.noise_optimization.take(),
            classifier_free: self.classifier_free.take(),
            edit: self.edit.take(),
            template: self.template.take().unwrap_or_default(),
        }
    }

    /// Refuses a key that was not taken.
    fn refuse_rest(&self) -> Result {
        // A table of plain values can always be converted to JSON.
        let rest = serde_json::to_value(self).unwrap_or_default();
        let keys = rest.as_object().into_iter().flatten();
        let mut left_over = keys.filter(|(key, _)| !["name", "model"].contains(&key.as_str()));
        let Some((key, value)) = left_over.next() else { return Ok(()) };
        let why = match OF_REQUESTS.contains(&key.as_str()) {
            true => "cannot be set in an arm: the request decides it",
            false => {
                "model = \"baseline\" has no such key, because Scene Transformer predicts in one pass and cannot be guided or \
                 edited; remove it, or set model = \"denoiser\""
            }
        };
        Err(Issue::new(format!("{key} of \"{}\"", self.name.escape_debug()), format_args!("is {value}, but {why}")))
    }
}

impl TryFrom<SweepKeys> for SweepConfig {
    type Error = Issue;

    fn try_from(mut keys: SweepKeys) -> Result<Self> {
        let config = Self {
            name: keys.name.clone(),
            n_scenes: keys.n_scenes.take().unwrap_or_default(),
            behavior: keys.behavior.take(),
            pairs: keys.pairs.take().unwrap_or_default(),
            aim: keys.aim.take().unwrap_or_default(),
            select: keys.select.take(),
            stop_after_verified: keys.stop_after_verified.take(),
            sampling: keys.take_sampling(),
        };
        keys.refuse_rest().map(|()| config)
    }
}

impl TryFrom<SweepKeys> for ArmConfig {
    type Error = Issue;

    fn try_from(mut keys: SweepKeys) -> Result<Self> {
        let config = Self { name: keys.name.clone(), sampling: keys.take_sampling() };
        keys.refuse_rest().map(|()| config)
    }
}

impl From<SweepConfig> for SweepKeys {
    fn from(config: SweepConfig) -> Self {
        Self {
            n_scenes: Some(config.n_scenes),
            behavior: config.behavior,
            pairs: Some(config.pairs),
            aim: Some(config.aim),
            select: config.select,
            stop_after_verified: config.stop_after_verified,
            ..Self::from(ArmConfig { name: config.name, sampling: config.sampling })
        }
    }
}

impl From<ArmConfig> for SweepKeys {
    fn from(config: ArmConfig) -> Self {
        let SamplingConfig { n_samples, observe, model } = config.sampling;
        let (model, diffusion) = match model {
            ModelConfig::Denoiser(diffusion) => (ModelKey::Denoiser, Some(diffusion)),
            ModelConfig::Distilled(diffusion) => (ModelKey::Distilled, Some(diffusion)),
            ModelConfig::Baseline => (ModelKey::Baseline, None),
        };
        let keys =
            Self { name: config.name, model, n_samples: Some(n_samples), observe: Some(observe), ..Self::default() };
        let Some(diffusion) = diffusion else { return keys };
        let SweepGuidance {
            gate,
            classifier_scope,
            classifier_input,
            classifier_potential,
            objectives,
            objective_guidance,
        } = diffusion.guidance;
        Self {
            sampler: diffusion.sampler,
            validity_strength: diffusion.validity_strength,
            strengths: Some(diffusion.strengths),
            guidance: Some(gate),
            classifier_scope: Some(classifier_scope),
            classifier_input: Some(classifier_input),
            classifier_potential: Some(classifier_potential).filter(|potential| !potential.is_default()),
            objectives: Some(objectives),
            objective_guidance: Some(objective_guidance),
            particles: diffusion.particles,
            noise_optimization: diffusion.noise_optimization,
            classifier_free: diffusion.classifier_free,
            edit: diffusion.edit,
            template: diffusion.template.then_some(true),
            ..keys
        }
    }
}

/// The schema of arms: that of sweeps without what requests decide.
pub(super) fn without_keys_of_requests(schema: &mut Schema) {
    if let Some(properties) = schema.get_mut("properties").and_then(serde_json::Value::as_object_mut) {
        OF_REQUESTS.iter().for_each(|key| _ = properties.remove(*key));
    }
}
