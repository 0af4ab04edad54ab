//! The `[generate]` section: how many scenarios of what kind, from which scenes.

use super::{
    ClassifierFreeConfig, ClassifierInput, ClassifierScope, EditConfig, Error, ObserveConfig, RequestConfig,
    SelectConfig, SweepModel,
};
use crate::diffusion::SamplerConfig;
use crate::diffusion::sampler::HeunConfig;
use crate::guidance::{GuidanceConfig, ObjectiveConfig, ObjectiveGuidanceConfig};
use crate::metrics::Group;
use crate::scene::Split;
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Enough to bring nearly all overlaps apart, and little enough to leave everything else where it is.
const DEFAULT_VALIDITY_STRENGTH: f64 = 200.0;

/// What to generate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateConfig {
    /// Splits whose scenes are continued; empty means `val`, or everything unsplit where there is no such split.
    pub splits: Vec<Split>,
    /// Places whose scenes are continued; empty means all.
    pub places: Vec<String>,
    /// How noise becomes a sample, where a sweep does not say it itself.
    pub sampler: SamplerConfig,
    /// How strongly samples are kept apart and on the road while they are denoised (the objectives `no_collision`,
    /// `stay_on_road` and `slip_limit`), where a sweep does not say it itself; 0: not at all, as in the paper. It costs no evaluations of the network.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub validity_strength: f64,
    /// Samples that are denoised together. Memory grows with it; of the results only the last digits can change with it.
    #[schemars(range(min = 1, max = 10_000))]
    pub batch_size: usize,
    /// Scenes of a shard, the unit in which generation is resumed.
    #[schemars(range(min = 1, max = 100_000))]
    pub scenes_per_shard: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// The sweeps, generated in order.
    pub sweeps: Vec<SweepConfig>,
    /// Ways of sampling that requests may try: settings of sweeps without behavior, `n_scenes`, `pairs` and `select`, which
    /// the request decides.
    pub arms: Vec<SweepConfig>,
    /// Events that are asked for by their parameters, after the sweeps.
    pub requests: Vec<RequestConfig>,
}

impl Default for GenerateConfig {
    fn default() -> Self {
        Self {
            splits: Vec::new(),
            places: Vec::new(),
            sampler: SamplerConfig::Heun(HeunConfig::with_steps(20)),
            validity_strength: DEFAULT_VALIDITY_STRENGTH,
            batch_size: 12,
            scenes_per_shard: 8,
            seed: 0,
            sweeps: Vec::new(),
            arms: Vec::new(),
            requests: Vec::new(),
        }
    }
}

/// One kind of scenarios: every chosen scene, at every strength, so many times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepConfig {
    /// Name, unique among the sweeps.
    pub name: String,
    /// Where samples come from: `denoiser`, `distilled` for the one that needs few evaluations, or `baseline` to compare with.
    /// The baseline has as many samples as joint futures at most, is not guided, and edits nothing.
    #[serde(default)]
    pub model: SweepModel,
    /// Number of scenes to continue.
    #[serde(default)]
    #[schemars(range(max = 1_000_000_000))]
    pub n_scenes: usize,
    /// How noise becomes a sample. Left out: as in the other sweeps.
    #[serde(default)]
    pub sampler: Option<SamplerConfig>,
    /// Number of samples of each scene at each strength.
    #[serde(default = "default_n_samples")]
    #[schemars(range(min = 1, max = 100_000))]
    pub n_samples: usize,
    /// Name of the mined behavior to ask for. Left out: scenes are continued as they may go on.
    #[serde(default)]
    pub behavior: Option<String>,
    /// Strengths α of guidance, which multiply classifier and objectives alike; 0 is unguided sampling of the same scenes, pairs
    /// and noise, for comparison. `validity_strength` acts at all of them.
    #[serde(default = "default_strengths")]
    pub strengths: Vec<f64>,
    /// When guidance acts and how far it may go.
    #[serde(default)]
    pub guidance: GuidanceConfig,
    /// Whom the classifier of the behavior looks at.
    #[serde(default)]
    pub classifier_scope: ClassifierScope,
    /// What the classifier of the behavior is shown.
    #[serde(default)]
    pub classifier_input: ClassifierInput,
    /// What is wished of trajectories beside the behavior, or instead of one.
    #[serde(default)]
    pub objectives: Vec<ObjectiveConfig>,
    /// How strongly samples are kept apart and on the road, at every strength of the guidance. Left out: as in the other sweeps. 0 for samples as
    /// the network has them, and where a collision is what is asked for.
    #[schemars(range(min = 0.0, max = 1e6))]
    #[serde(default)]
    pub validity_strength: Option<f64>,
    /// How objectives become shifts of the clean estimate.
    #[serde(default)]
    pub objective_guidance: ObjectiveGuidanceConfig,
    /// Which agents are asked for the behavior.
    #[serde(default)]
    pub pairs: PairSelectionConfig,
    /// Which states are observed: the name of a training task (`predictive`, `goal_conditioned`, `agent_conditioned`,
    /// `ego_conditioned`, `windowed`, `upsampling`, `imputation`), or a list of rules. The rest is generated.
    #[serde(default)]
    pub observe: ObserveConfig,
    /// States that samples lean toward, by classifier-free guidance.
    #[serde(default)]
    pub classifier_free: Option<ClassifierFreeConfig>,
    /// Changes of the recording that samples start from.
    #[serde(default)]
    pub edit: Option<EditConfig>,
    /// Which samples become scenarios. Left out: all.
    #[serde(default)]
    pub select: Option<SelectConfig>,
    /// No further shard of this sweep is begun once so many of its scenarios are verified. Left out: all are generated.
    #[serde(default)]
    #[schemars(range(min = 1))]
    pub stop_after_verified: Option<usize>,
}

fn default_n_samples() -> usize {
    6
}

fn default_strengths() -> Vec<f64> {
    vec![0.0]
}

/// Which agents of a scene are asked for a behavior of two agents, in the behavior's order of roles (for a cut-in: who is
/// cut off, who cuts in).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PairSelectionConfig {
    /// Pairs of each scene that are asked, one at a time.
    #[schemars(range(min = 1, max = 10_000))]
    pub per_scene: usize,
    /// Their largest distance at present, metres.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_distance_m: f64,
    /// Whether pairs are left out that cannot show the behavior, as far as their past and the limits of driving tell. The recorded
    /// future is never looked at.
    pub only_feasible: bool,
    /// Which of the possible pairs are asked first.
    pub ranking: PairRanking,
    /// Number of scenes to rank, of which those with the best pairs are taken. Left out: the first scenes, in random
    /// order, that have a possible pair at all.
    #[schemars(range(min = 1))]
    pub n_scenes_ranked: Option<usize>,
}

impl Default for PairSelectionConfig {
    fn default() -> Self {
        Self {
            per_scene: 1,
            max_distance_m: 30.0,
            only_feasible: true,
            ranking: PairRanking::default(),
            n_scenes_ranked: None,
        }
    }
}

/// Which of the possible pairs of a scene are asked first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PairRanking {
    /// Those for which the classifier finds the behavior likeliest from their history; without a classifier those that can show it most easily.
    #[default]
    Classifier,
    /// Those that can show it most easily, as far as the limits of driving tell; where these say nothing, the closest.
    Effort,
}

impl GenerateConfig {
    /// Says which value makes no sense.
    ///
    /// # Errors
    /// When there is one.
    pub fn validate(&self) -> Result<(), Error> {
        let refuse = |key: &str, why: &str| Err(Error::Config(format!("generate.{key} {why}")));
        let within = |issue: Issue| Error::Config(issue.within("generate").to_string());
        settings::check_ranges(self).map_err(within)?;
        self.sampler.validate().map_err(|issue| within(issue.within("sampler")))?;
        if self.sweeps.is_empty() && self.requests.is_empty() {
            return refuse(
                "sweeps",
                "is empty: add a [[generate.sweeps]] table with a name and n_scenes, or [[generate.requests]]",
            );
        }
        let mut names = BTreeSet::new();
        for (i, sweep) in self.sweeps.iter().enumerate() {
            settings::printable_name(&format!("sweeps.{i}.name"), &sweep.name).map_err(within)?;
            // Tables name groups of traffic by one word, which is a sweep's name for what it guides or edits.
            if Group::RESERVED.contains(&sweep.name.as_str()) {
                let name = format!("sweeps.{i}.name");
                return refuse(
                    &name,
                    &format!("is \"{}\", which tables call other traffic: choose another", sweep.name),
                );
            }
            if !names.insert(&sweep.name) {
                return refuse(
                    &format!("sweeps.{i}.name"),
                    &format!("is \"{}\", the name of another sweep: choose another", sweep.name),
                );
            }
            sweep.check_levels().map_err(|issue| within(issue.within(&format!("sweeps.{i}"))))?;
            if let Err(why) = sweep.validate(self) {
                return refuse(&format!("sweeps.{i}"), &why);
            }
        }
        self.resolve().map(drop)
    }
}

impl GenerateConfig {
    /// Whether sweeps select, or requests accept, by metrics of which `is_such` holds.
    pub fn selects_by(&self, is_such: impl Fn(&str) -> bool) -> bool {
        let mut of_sweeps = self.sweeps.iter().filter_map(|sweep| sweep.select.as_ref());
        of_sweeps.any(|select| select.names_metric(&is_such))
            || self.requests.iter().flat_map(|request| request.limits.keys()).any(|id| is_such(id))
    }
}

impl SweepConfig {
    /// How noise becomes a sample of this sweep.
    pub fn sampler<'a>(&'a self, config: &'a GenerateConfig) -> &'a SamplerConfig {
        self.sampler.as_ref().unwrap_or(&config.sampler)
    }

    /// How strongly samples of this sweep are kept apart and on the road. The baseline's cannot be.
    pub fn validity_strength(&self, config: &GenerateConfig) -> f64 {
        match self.model {
            SweepModel::Baseline => 0.0,
            SweepModel::Denoiser | SweepModel::Distilled => self.validity_strength.unwrap_or(config.validity_strength),
        }
    }

    /// Calls of the network for one sample of this sweep; classifier-free guidance asks it twice, the baseline once.
    pub fn n_evaluations(&self, config: &GenerateConfig) -> u64 {
        if self.model == SweepModel::Baseline {
            return 1;
        }
        let n_calls = if self.classifier_free.is_some() { 2 } else { 1 };
        self.sampler(config).n_evaluations() as u64 * n_calls
    }

    /// Refuses levels that come twice, whose samples could not be told apart, and noise levels at which nothing would be guided.
    pub(super) fn check_levels(&self) -> settings::Result {
        settings::distinct("strengths", &self.strengths)?;
        if let Some(config) = &self.classifier_free {
            settings::distinct("classifier_free.weights", &config.weights)?;
        }
        let GuidanceConfig { sigma_lo, sigma_hi, .. } = self.guidance;
        settings::ascending(("guidance.sigma_lo", sigma_lo), ("guidance.sigma_hi", sigma_hi))
    }

    /// Says what makes no sense in a sweep of `config`.
    pub(super) fn validate(&self, config: &GenerateConfig) -> Result<(), String> {
        let counts = [("n_scenes", self.n_scenes), ("strengths (their number)", self.strengths.len())];
        if let Some((key, value)) = counts.iter().find(|(_, value)| *value == 0) {
            return Err(format!("({}): {key} is {value}, expected at least 1", self.name));
        }
        if let Some(strength) = self.strengths.iter().find(|strength| !strength.is_finite()) {
            return Err(format!("({}): a strength is {strength}, expected a number", self.name));
        }
        if let Some(sampler) = &self.sampler {
            sampler.validate().map_err(|issue| format!("({}): {}", self.name, issue.within("sampler")))?;
        }
        self.check_model(self.sampler(config)).map_err(|why| format!("({}): {why}", self.name))?;
        self.check_guidance().map_err(|why| format!("({}): {why}", self.name))?;
        if let Some(select) = &self.select {
            let kinds: Vec<&str> = self.objectives.iter().map(|objective| objective.objective().kind()).collect();
            select.validate(&kinds, self.asks_pairs()).map_err(|why| format!("({}): select: {why}", self.name))?;
        }
        // The roles of the behavior are known only beside the list of behaviors; without one there are none.
        match self.behavior {
            None => self.validate_conditioning(&[]).map_err(|why| format!("({}): {why}", self.name)),
            Some(_) => Ok(()),
        }
    }
}
