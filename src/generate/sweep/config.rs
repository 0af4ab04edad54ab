//! A sweep or an arm as written in TOML: one flat table.

use crate::diffusion::SamplerConfig;
use crate::generate::{ClassifierFreeConfig, EditConfig, ObserveConfig, PairSelectionConfig, SweepRollout};
use crate::guidance::{ClassifierPotential, GuidanceConfig, ObjectiveConfig};
use crate::settings::{Issue, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

/// Keys that an arm does not have, because they are up to the request that names the arm.
const OF_REQUESTS: &[&str] = &["n_scenes", "behavior", "pairs", "aim"];
/// Keys that the baseline does not have.
const OF_DIFFUSION: &[&str] = &[
    "sampler",
    "strengths",
    "guidance",
    "classifier_scope",
    "classifier_potential",
    "objectives",
    "validity_strength",
    "classifier_free",
    "edit",
    "template",
    "rollout",
];

/// A sweep, `[[generate.sweeps]]`: every chosen scene, at every guidance level, `n_samples` times. An arm,
/// `[[generate.arms]]`, is a way of sampling that requests may try: the request decides on scenes, pairs and behavior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepConfig {
    /// Name, unique among the sweeps or arms.
    pub name: String,
    /// Where samples come from: `denoiser`, `distilled` (few evaluations), or `baseline`. The baseline has at most as
    /// many samples as joint futures; of the keys about sampling it accepts only `n_samples` and `observe`.
    #[serde(default)]
    pub model: SampledModel,
    /// Number of scenes to continue.
    #[serde(default)]
    #[schemars(range(max = 1_000_000_000))]
    pub n_scenes: usize,
    /// How noise becomes a sample. Left out: as in the other sweeps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sampler: Option<SamplerConfig>,
    /// Number of samples of each scene at each strength. Left out: 6.
    #[serde(default = "six")]
    #[schemars(range(min = 1, max = 100_000))]
    pub n_samples: usize,
    /// Name of the mined behavior to request. Left out: scenes are continued without a request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub behavior: Option<String>,
    /// Strengths α of guidance, which multiply classifier and objectives alike; 0 is unguided sampling of the same
    /// scenes, pairs and noise, for comparison. `validity_strength` acts at all of them. Left out: 0 alone.
    #[serde(default = "unguided")]
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub strengths: Vec<f64>,
    /// When guidance acts and how far it may go.
    #[serde(default)]
    pub guidance: GuidanceConfig,
    /// Which agents the classifier of the behavior judges.
    #[serde(default)]
    pub classifier_scope: ClassifierScope,
    /// The output of the classifier to maximize: log p or log odds.
    #[serde(default, skip_serializing_if = "ClassifierPotential::is_default")]
    pub classifier_potential: ClassifierPotential,
    /// Objectives for the trajectories, in addition to a behavior or instead of one.
    #[serde(default)]
    pub objectives: Vec<ObjectiveConfig>,
    /// How strongly samples are kept apart and on the road, at every guidance strength. Left out: as in the other
    /// sweeps. Use 0 for raw samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub validity_strength: Option<f64>,
    /// Which agents are to show the behavior.
    #[serde(default)]
    pub pairs: PairSelectionConfig,
    /// Which events guided samples aim at.
    #[serde(default)]
    pub aim: Aim,
    /// Which states are observed: the name of a training task (`predictive`, `goal_conditioned`, `agent_conditioned`,
    /// `ego_conditioned`, `windowed`, `upsampling`, `imputation`), or a list of rules. The rest is generated. Left out:
    /// `predictive`.
    #[serde(default)]
    pub observe: ObserveConfig,
    /// States that samples lean toward, by classifier-free guidance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub classifier_free: Option<ClassifierFreeConfig>,
    /// Edits of the recording that samples start from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edit: Option<EditConfig>,
    /// Whether the agents of the event follow a template: a maneuver along the lanes that is solved for the sample's
    /// target. The denoiser observes all of it and samples everybody else. If no maneuver reaches the target, the
    /// sample follows another one; if there is none at all, it is sampled freely. Every behavior but
    /// `cut_in_paper` has templates. Left out: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub template: bool,
    /// How scenarios go on in a closed loop, for longer than they were sampled. Left out: they end with the sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rollout: Option<SweepRollout>,
}

impl SweepConfig {
    /// Rejects keys of an arm that are up to the request.
    pub(super) fn check_arm(&self) -> Result {
        self.refuse(OF_REQUESTS, "cannot be set in an arm: the request decides it")
    }

    /// Rejects keys that the baseline does not have.
    pub(super) fn check_baseline(&self) -> Result {
        let why = "model = \"baseline\" has no such key, because Scene Transformer predicts in one pass and cannot be \
                   guided or edited; remove it, or set model = \"denoiser\"";
        self.refuse(OF_DIFFUSION, why)
    }

    /// Rejects the first of these keys that does not have its default value.
    fn refuse(&self, keys: &[&str], why: &str) -> Result {
        // A table of plain values can always be converted to JSON.
        let of = |sweep: &Self| serde_json::to_value(sweep).unwrap_or_default();
        let default = serde_json::from_value(json!({ "name": self.name })).map(|default| of(&default));
        let (own, default) = (of(self), default.unwrap_or_default());
        match keys.iter().find(|key| own.get(**key) != default.get(**key)) {
            Some(key) => Err(Issue::new(*key, format_args!("is {}, but {why}", own[*key]))),
            None => Ok(()),
        }
    }
}

const fn six() -> usize {
    6
}

fn unguided() -> Vec<f64> {
    vec![0.0]
}

/// Which model the samples of a sweep come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SampledModel {
    /// The denoiser: samples are independent draws, in any number.
    #[default]
    Denoiser,
    /// The denoiser of `[train.distill]`, in few evaluations: with `sampler = { kind = "euler" }` and the `n_steps` and
    /// `grid` of `train.distill.method`.
    Distilled,
    /// Scene Transformer of `[train.baseline]`: samples are its joint futures, the most likely first, with their
    /// probabilities.
    Baseline,
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
    /// As `feasible`, but only events that are hard to avoid: those that close a gap in at most 2.5 s more than UN
    /// Regulation No. 157 (paragraph 5.2.5.2) leaves to react, harder ones more often. Pairs that can show none are
    /// left out. Events without `gap_m` and `relative_speed_mps` come alike.
    Hard,
}
