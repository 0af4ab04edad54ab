//! The `[train.denoiser]` section: a preset, and the settings over it.

use super::objective_loss::check_objectives;
use super::section::{SceneTraining, scene_training_section};
use super::{Error, FitConfig, OwnScenes, Preset, SceneChoice};
use crate::diffusion::{Edm, NoiseDistribution};
use crate::guidance::ObjectiveConfig;
use crate::model::NetworkConfig;
use crate::settings::Issue;
use crate::tensor::{StateParametrization, TaskWeights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The least and the most time that a training may be given, seconds.
const LEAST_S: f64 = 10.0;
const MOST_S: f64 = 60.0 * 86_400.0;
/// The higher of the learning rates that a training tries that starts from a checkpoint and is given time.
const FURTHER_RATE: f64 = 4e-4;
/// How often such a training draws own scenes for one of other runs.
const OWN_FOR_OTHERS: f64 = 3.0;
/// Its tasks: those of the bundled denoisers.
const MOSTLY_PREDICTION: TaskWeights = TaskWeights {
    predictive: 80.0,
    goal_conditioned: 10.0,
    agent_conditioned: 2.0,
    ego_conditioned: 2.0,
    windowed: 2.0,
    upsampling: 2.0,
    imputation: 2.0,
};

/// What has equal weight in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Balance {
    /// Every scene: places with many scenes are drawn more often.
    #[default]
    Scenes,
    /// Every place: scenes of places with few scenes are drawn more often.
    Places,
}

/// The scenes whose motion sets the scales of a training that starts from a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Scales {
    /// The new ones: samples have their texture, and what the network knows has to be learned again in part.
    #[default]
    Recordings,
    /// Those of the checkpoint: for more recordings of its kind.
    Checkpoint,
}

scene_training_section! {
    /// How to train the denoiser. Settings left out are the preset's.
    #[derive(Default)]
    pub struct DenoiserTrainingConfig in "train.denoiser", each Option {
        /// Size of the network: `tiny`, `small`, `large`, `paper_small` or `paper`.
        pub preset: Preset,
        /// The time that training takes in all, such as `"30 min"` or `"2 h"`, instead of `steps`. It chooses steps,
        /// learning rate, scales of motion, the scenes of evaluations and their number, draws mostly prediction and, of
        /// `data`, a quarter of all scenes, unless other settings say so. At most a quarter of the time goes into
        /// measuring. It ends with the weights whose samples of held-out scenes have the least error. With
        /// `start_from`, closed loops of them are compared with loops of that, too, and where either gets worse, it
        /// stays as it is.
        #[serde(rename = "for", skip_serializing_if = "Option::is_none")]
        pub time: Option<String>,
        /// The network, to override the preset's.
        pub network: Option<NetworkConfig>,
        /// What is diffused: `scene` (the paper's) or `motion`.
        pub state_parametrization: Option<StateParametrization>,
        /// Learning rate after warm-up.
        #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1000))]
        pub learning_rate: Option<f64>,
        /// Steps over which the learning rate rises from 0. Left out: the preset's, at most a tenth of all.
        #[schemars(range(max = 1_000_000_000))]
        pub warmup_steps: Option<u64>,
        /// Steps between saved states. Left out: half of those between evaluations.
        #[schemars(range(min = 1, max = 1_000_000_000))]
        pub save_every: Option<u64>,
        /// Held-out scenes of each evaluation during training.
        #[schemars(range(max = 1_000_000))]
        pub n_eval_scenes: Option<usize>,
        /// Decay of the moving average of the weights; 0 for none.
        #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1))]
        pub ema_decay: Option<f64>,
        /// Objectives for clean estimates at low noise, in addition to the loss: each adds its weight times its cost
        /// beyond that of the recording, √(1 - 2 J) - 1 per scene.
        pub objectives: Vec<ObjectiveConfig>,
        /// The noise level σ up to which they count (default 0.3): above it an estimate is a mean of futures, to which
        /// the rules of traffic do not apply.
        #[schemars(extend("exclusiveMinimum" = 0))]
        pub objectives_below_sigma: Option<f64>,
        /// What is drawn with equal weight in training: `scenes` or `places`.
        pub balance: Option<Balance>,
        /// Maximum number of agents per scene, nearest to the ego agent.
        #[schemars(range(min = 1, max = 10_000))]
        pub max_agents: Option<usize>,
        /// Maximum number of lane polylines per scene, nearest to the ego agent.
        #[schemars(range(max = 100_000))]
        pub max_lanes: Option<usize>,
        /// Dimensions of a diffused state: 3 (x, y, heading) or 2 (x, y). Left out: that of `start_from`;
        /// without one 2 for Argoverse 1, else 3.
        #[schemars(range(min = 2, max = 3))]
        pub state_dim: Option<usize>,
        /// A checkpoint of the same network to start from: to train it further, or on other scenes. Training then ends
        /// with the weights, those that it started from among them, whose samples of held-out scenes have the least
        /// error.
        pub start_from: Option<std::path::PathBuf>,
        /// Where a training that starts from a checkpoint takes the scales of motion from: `recordings` (default), or
        /// `checkpoint` if that knows recordings of this kind. With `for`, what is better on held-out scenes.
        pub scales: Option<Scales>,
    }
}

/// The resolved section, with every value decided.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DenoiserTraining {
    /// The network.
    pub network: NetworkConfig,
    /// The quantity that is diffused.
    pub parametrization: StateParametrization,
    /// Constants of the diffusion.
    pub edm: Edm,
    /// Distribution of the training noise levels.
    pub noise: NoiseDistribution,
    /// Weight of the squared error of the path to which diffused motion adds up, relative to that of the motion
    /// itself (motion parametrization only). The optimal denoiser is the same at any weight; the weight decides
    /// what a network learns first.
    pub path_loss: f64,
    /// Objectives for clean estimates at low noise.
    pub objectives: Vec<ObjectiveConfig>,
    /// The noise level up to which they count.
    pub objectives_below_sigma: f64,
    /// The unit that is drawn with equal weight.
    pub balance: Balance,
    /// The scenes whose motion sets the scales of a training that starts from a checkpoint.
    pub scales: Scales,
    /// Maximum number of agents per scene.
    pub max_agents: usize,
    /// Maximum number of lane polylines per scene.
    pub max_lanes: usize,
    /// The time for it, and what it may choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within: Option<Within>,
    /// Tasks, batches, evaluations and the schedule.
    #[serde(flatten)]
    pub common: SceneTraining,
}

/// What a training that is given time may choose from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Within {
    /// The time for all of it, seconds.
    pub seconds: f64,
    /// The learning rates that are tried; the first where there is no time to try any.
    pub learning_rates: Vec<f64>,
    /// The scales of motion that are tried, of a training that starts from a checkpoint.
    pub scales: Vec<Scales>,
    /// Held-out scenes of each evaluation; `None`: as many as there is time for.
    pub n_eval_scenes: Option<usize>,
}

impl DenoiserTrainingConfig {
    /// The scenes it trains on: if it chooses the mixture, a quarter from other runs.
    pub fn mixture<'a>(&'a self, own: OwnScenes<'a>) -> SceneChoice<'a> {
        let choice = self.scene_choice(own);
        let others: f64 = self.data.iter().map(|more| more.weight).sum();
        match self.time.is_some() && self.own_weight.is_none() && others > 0.0 {
            true => SceneChoice { own_weight: OWN_FOR_OTHERS * others, ..choice },
            false => choice,
        }
    }

    /// The time for it, and what it may choose from.
    fn within(&self, base: &FitConfig) -> Result<Option<Within>, Error> {
        let Some(text) = &self.time else { return Ok(None) };
        let refuse = |why: String| Self::refusal(Issue::new("for", why));
        let given = humantime::parse_duration(text)
            .map_err(|error| refuse(format!("is {text:?}, expected a time such as \"30 min\" or \"2 h\": {error}")))?;
        if !(LEAST_S..=MOST_S).contains(&given.as_secs_f64()) {
            return Err(refuse(format!("is {text:?}, expected 10 s to 60 days")));
        }
        if let Some(key) = self.steps.map(|_| "steps").or_else(|| self.evaluate_every.map(|_| "evaluate_every")) {
            return Err(refuse(format!("goes without `{key}`, which it chooses: remove one of them")));
        }
        let further = self.start_from.as_ref().map(|_| FURTHER_RATE);
        let high = further.unwrap_or(base.learning_rate);
        let learning_rates = self.learning_rate.map_or_else(|| vec![high, high / 3.0], |rate| vec![rate]);
        let scales = self.scales.map_or_else(|| vec![Scales::Recordings, Scales::Checkpoint], |scales| vec![scales]);
        let n_eval_scenes = self.n_eval_scenes;
        Ok(Some(Within { seconds: given.as_secs_f64(), learning_rates, scales, n_eval_scenes }))
    }

    /// The preset with the section's settings over it.
    pub fn resolve(&self) -> Result<DenoiserTraining, Error> {
        let mut base = self.preset.settings();
        self.check_ranges()?;
        let within = self.within(&base.common.fit)?;
        if within.is_some() {
            base.common.tasks = MOSTLY_PREDICTION;
        }
        let mut common = self.scene_training(&base.common)?;
        common.n_eval_scenes = self.n_eval_scenes.unwrap_or(common.n_eval_scenes);
        common.fit.save_every = self.save_every.unwrap_or(common.fit.save_every);
        common.fit.learning_rate = self.learning_rate.unwrap_or(common.fit.learning_rate);
        let few = common.fit.warmup_steps.min(common.fit.steps / 10);
        common.fit.warmup_steps = self.warmup_steps.unwrap_or(few);
        common.fit.ema_decay = self.ema_decay.unwrap_or(common.fit.ema_decay);
        check_objectives("train.denoiser.objectives", &self.objectives)?;
        let parametrization = self.state_parametrization.unwrap_or(base.parametrization);
        // Settings of the preset that only fit diffused motion do not apply to other parametrizations.
        let fits = parametrization == base.parametrization;
        let base_network = if fits { base.network } else { base.network.without_paths() };
        let network = self.network.clone().unwrap_or(base_network);
        let path_loss = if fits { base.path_loss } else { 0.0 };
        if parametrization != StateParametrization::Motion && network.path_input {
            let message = "train.denoiser.network.path_input needs state_parametrization = \"motion\"";
            return Err(Error::Config(message.to_owned()));
        }
        if network.geometry.is_some() && parametrization != StateParametrization::Motion {
            let message = "train.denoiser.network.geometry needs state_parametrization = \"motion\"";
            return Err(Error::Config(message.to_owned()));
        }
        network.validate().map_err(|issue| Self::refusal(issue.within("network")))?;
        Ok(DenoiserTraining {
            network,
            parametrization,
            edm: base.edm,
            noise: base.noise,
            path_loss,
            objectives: self.objectives.clone(),
            objectives_below_sigma: self.objectives_below_sigma.unwrap_or(base.objectives_below_sigma),
            balance: self.balance.unwrap_or(base.balance),
            scales: self.scales.unwrap_or(base.scales),
            max_agents: self.max_agents.unwrap_or(base.max_agents),
            max_lanes: self.max_lanes.unwrap_or(base.max_lanes),
            within,
            common,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_trainings_warm_up_for_a_tenth_of_their_steps() {
        let warmup_steps = |steps: u64, own: Option<u64>| {
            let config = DenoiserTrainingConfig { steps: Some(steps), warmup_steps: own, ..Default::default() };
            config.resolve().unwrap().common.fit.warmup_steps
        };
        assert_eq!([(30, None), (8_000, None), (30, Some(20))].map(|(n, own)| warmup_steps(n, own)), [3, 200, 20]);
    }

    #[test]
    fn the_geometry_of_a_preset_is_left_out_where_it_does_not_fit() {
        let config = DenoiserTrainingConfig {
            preset: Preset::Small,
            state_parametrization: Some(StateParametrization::Scene),
            ..Default::default()
        };
        let network = config.resolve().unwrap().network;
        // The encoding stays within the network's width.
        assert_eq!((network.geometry, network.encoding), (None, network.width));
    }
}
