//! The `[train.denoiser]` section: presets from a test's network to the paper's, and what overrides them.

use super::objective_loss::check_objectives;
use super::{Error, FitConfig, LearningRateDecay};
use crate::diffusion::{Edm, LossWeight, NoiseDistribution};
use crate::guidance::ObjectiveConfig;
use crate::model::{GeometryConfig, NetworkConfig};
use crate::scene::Split;
use crate::settings::{self, Issue};
use crate::tensor::{StateParametrization, TaskWeights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A size of network with settings that suit it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The geometric network with 4 layers, 32 wide: trains in a minute, for tests and first looks.
    Tiny,
    /// The geometric network with 7 layers, 96 wide: for a laptop.
    #[default]
    Small,
    /// The geometric network with 13 layers, 256 wide: for a GPU.
    Large,
    /// The paper's network with 7 layers, 96 wide, motion parametrization: what `small` is compared with.
    PaperSmall,
    /// The paper's 15 layers, 256 wide, with its parametrization, batch size and learning rate.
    Paper,
}

/// What counts the same in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Balance {
    /// Every scene: places with many scenes are seen more often.
    #[default]
    Scenes,
    /// Every place: scenes of places with few of them are seen more often.
    Places,
}

/// How to train the denoiser. What is left out is the preset's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(deny_unknown_fields, default)]
pub struct DenoiserTrainingConfig {
    /// Size of the network: `tiny`, `small`, `large`, `paper_small` or `paper`.
    pub preset: Preset,
    /// The network, where the preset's does not fit.
    pub network: Option<NetworkConfig>,
    /// What is diffused: `scene` (the paper's), `residual` or `motion`.
    pub state_parametrization: Option<StateParametrization>,
    /// Constants of the diffusion.
    pub diffusion: Edm,
    /// Distribution of the training noise levels.
    pub noise: Option<NoiseDistribution>,
    /// Weight of the noise levels in the loss: `edm` or `unit`.
    pub loss_weight: LossWeight,
    /// Weight of the squared error of what diffused motion adds up to, beside that of the motion itself (motion
    /// parametrization only). The best denoiser is the same at any weight; it decides what a network learns first.
    #[schemars(range(min = 0.0))]
    pub path_loss: Option<f64>,
    /// Objectives that clean estimates are trained toward at low noise, beside the loss: each counts by its weight and a cost of
    /// √(1 - 2 J) - 1 a scene, beyond that of the recording.
    pub objectives: Vec<ObjectiveConfig>,
    /// The noise level σ up to which they count (default 0.3): above it an estimate is a mean of futures, which no rule of traffic binds.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub objectives_below_sigma: Option<f64>,
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
    /// Splits to train on; empty means `train`, or everything unsplit where there is no such split.
    pub splits: Vec<Split>,
    /// Places to train on; empty means all.
    pub places: Vec<String>,
    /// Whether every scene counts the same, or every place: `scenes` or `places`.
    pub balance: Option<Balance>,
    /// Optimizer steps in all.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub steps: Option<u64>,
    /// Scenes a step.
    #[schemars(range(min = 1, max = 16_384))]
    pub batch_size: Option<usize>,
    /// Learning rate after warm-up.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub learning_rate: Option<f64>,
    /// Steps over which the learning rate rises from 0.
    #[schemars(range(max = 1_000_000_000))]
    pub warmup_steps: Option<u64>,
    /// How the learning rate goes on: `constant` or `cosine`.
    pub decay: Option<LearningRateDecay>,
    /// Gradients are scaled down to this global norm.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub clip_norm: Option<f64>,
    /// Decay of the moving average of the weights; 0 for none.
    #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1))]
    pub ema_decay: Option<f64>,
    /// At most so many agents a scene, nearest to the ego agent.
    #[schemars(range(min = 1, max = 10_000))]
    pub max_agents: Option<usize>,
    /// At most so many lane polylines a scene, nearest to the ego agent.
    #[schemars(range(max = 100_000))]
    pub max_lanes: Option<usize>,
    /// Dimensions of a diffused state: 3 (x, y, heading) or 2 (x, y). Left out: 2 for Argoverse 1, else 3.
    #[schemars(range(min = 2, max = 3))]
    pub state_dim: Option<usize>,
    /// Held-out scenes of each evaluation during training.
    #[schemars(range(max = 1_000_000))]
    pub n_eval_scenes: Option<usize>,
    /// Steps between evaluations.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub evaluate_every: Option<u64>,
    /// Steps between saved states.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub save_every: Option<u64>,
    /// A trained checkpoint to start from, of the same network: to train it further, or on other scenes.
    pub start_from: Option<std::path::PathBuf>,
    /// A trained checkpoint to use instead of training.
    pub checkpoint: Option<std::path::PathBuf>,
}

/// The same with every value decided.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DenoiserTraining {
    /// The network.
    pub network: NetworkConfig,
    /// What is diffused.
    pub parametrization: StateParametrization,
    /// Constants of the diffusion.
    pub edm: Edm,
    /// Distribution of the training noise levels.
    pub noise: NoiseDistribution,
    /// Weight of the noise levels in the loss.
    pub loss_weight: LossWeight,
    /// Weight of the error of paths in the loss.
    pub path_loss: f64,
    /// What clean estimates are trained toward at low noise.
    pub objectives: Vec<ObjectiveConfig>,
    /// The noise level up to which they count.
    pub objectives_below_sigma: f64,
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
    /// What counts the same.
    pub balance: Balance,
    /// Scenes a step.
    pub batch_size: usize,
    /// At most so many agents a scene.
    pub max_agents: usize,
    /// At most so many lane polylines a scene.
    pub max_lanes: usize,
    /// Held-out scenes of each evaluation during training.
    pub n_eval_scenes: usize,
    /// The loop.
    pub fit: FitConfig,
}

impl DenoiserTrainingConfig {
    /// The preset with everything that the section says laid over it.
    ///
    /// # Errors
    /// When a value makes no sense, naming it.
    pub fn resolve(&self) -> Result<DenoiserTraining, Error> {
        let base = self.preset.settings();
        let fit = FitConfig {
            steps: self.steps.unwrap_or(base.fit.steps),
            learning_rate: self.learning_rate.unwrap_or(base.fit.learning_rate),
            warmup_steps: self.warmup_steps.unwrap_or(base.fit.warmup_steps),
            decay: self.decay.unwrap_or(base.fit.decay),
            clip_norm: self.clip_norm.unwrap_or(base.fit.clip_norm),
            ema_decay: self.ema_decay.unwrap_or(base.fit.ema_decay),
            evaluate_every: self.evaluate_every.unwrap_or(base.fit.evaluate_every),
            save_every: self.save_every.unwrap_or(base.fit.save_every),
            log_every: base.fit.log_every,
        };
        let objectives_below_sigma = self.objectives_below_sigma.unwrap_or(base.objectives_below_sigma);
        let within = |issue: Issue| Error::Config(issue.within("train.denoiser").to_string());
        settings::check_ranges(self).map_err(within)?;
        let Edm { sigma_min, sigma_max, .. } = self.diffusion;
        settings::ascending(("diffusion.sigma_min", sigma_min), ("diffusion.sigma_max", sigma_max)).map_err(within)?;
        if self.tasks.probabilities().is_none() {
            let message = "train.denoiser.tasks are no weights: give numbers of at least 0, one of them positive";
            return Err(Error::Config(message.to_owned()));
        }
        check_objectives("train.denoiser.objectives", &self.objectives)?;
        let parametrization = self.state_parametrization.unwrap_or(base.parametrization);
        // What suits diffused motion only is not carried over from the preset to another parametrization.
        let fits = parametrization == base.parametrization;
        let base_network = if fits { base.network } else { base.network.without_paths() };
        let network = self.network.clone().unwrap_or(base_network);
        let path_loss = self.path_loss.unwrap_or(if fits { base.path_loss } else { 0.0 });
        if parametrization != StateParametrization::Motion && (network.path_input || path_loss != 0.0) {
            let message = "train.denoiser.network.path_input and train.denoiser.path_loss need \
                           state_parametrization = \"motion\"";
            return Err(Error::Config(message.to_owned()));
        }
        if network.geometry.is_some() && parametrization != StateParametrization::Motion {
            let message = "train.denoiser.network.geometry needs state_parametrization = \"motion\"";
            return Err(Error::Config(message.to_owned()));
        }
        network.validate().map_err(|issue| within(issue.within("network")))?;
        Ok(DenoiserTraining {
            network,
            parametrization,
            edm: self.diffusion,
            noise: self.noise.unwrap_or(base.noise),
            loss_weight: self.loss_weight,
            path_loss,
            objectives: self.objectives.clone(),
            objectives_below_sigma,
            tasks: self.tasks,
            balance: self.balance.unwrap_or(base.balance),
            batch_size: self.batch_size.unwrap_or(base.batch_size),
            max_agents: self.max_agents.unwrap_or(base.max_agents),
            max_lanes: self.max_lanes.unwrap_or(base.max_lanes),
            n_eval_scenes: self.n_eval_scenes.unwrap_or(base.n_eval_scenes),
            fit,
        })
    }
}

impl Preset {
    /// Everything that it decides for the denoiser.
    pub(super) fn settings(self) -> DenoiserTraining {
        match self {
            Self::Tiny => DenoiserTraining {
                network: geometric("TMAT", 32, 2),
                batch_size: 8,
                max_agents: 12,
                max_lanes: 32,
                n_eval_scenes: 16,
                fit: schedule(400, 2e-3, 20, 200),
                ..base()
            },
            Self::Small => DenoiserTraining {
                network: geometric("TMATMAT", 96, 4),
                batch_size: 16,
                max_agents: 20,
                max_lanes: 48,
                n_eval_scenes: 48,
                fit: FitConfig { ema_decay: 0.995, ..schedule(8_000, 1.5e-3, 200, 500) },
                ..base()
            },
            Self::Large => DenoiserTraining {
                network: geometric("TMATMATMATMAT", 256, 8),
                batch_size: 64,
                max_agents: 64,
                max_lanes: 256,
                n_eval_scenes: 200,
                fit: FitConfig { ema_decay: 0.999, ..schedule(200_000, 5e-4, 1_000, 5_000) },
                ..base()
            },
            // Diffused motion is of unit size: encodings with periods below 1 would show the network noise and little else.
            Self::PaperSmall => DenoiserTraining {
                network: NetworkConfig {
                    layers: "TATM TAT".to_owned(),
                    width: 96,
                    n_heads: 4,
                    feed_forward: 4 * 96,
                    encoding: 32,
                    latent_periods: [1.0, 100.0],
                    path_input: true,
                    geometry: None,
                },
                noise: NoiseDistribution { p_mean: -0.5, p_std: 1.4 },
                balance: Balance::Scenes,
                batch_size: 8,
                max_agents: 16,
                max_lanes: 48,
                n_eval_scenes: 48,
                fit: schedule(8_000, 1e-3, 200, 500),
                ..base()
            },
            Self::Paper => DenoiserTraining {
                network: NetworkConfig::default(),
                parametrization: StateParametrization::Scene,
                noise: NoiseDistribution::default(),
                path_loss: 0.0,
                balance: Balance::Scenes,
                batch_size: 32,
                max_agents: 64,
                max_lanes: 256,
                n_eval_scenes: 200,
                fit: FitConfig {
                    decay: LearningRateDecay::Constant,
                    ema_decay: 0.0,
                    ..schedule(200_000, 3e-4, 133, 5_000)
                },
                ..base()
            },
        }
    }
}

/// What the presets have in common unless they say otherwise.
fn base() -> DenoiserTraining {
    DenoiserTraining {
        network: NetworkConfig::default(),
        parametrization: StateParametrization::Motion,
        edm: Edm::default(),
        // What a network has to say of a path as a whole, it says at higher noise levels than of its details.
        noise: NoiseDistribution { p_mean: -0.3, p_std: 1.5 },
        loss_weight: LossWeight::default(),
        path_loss: 0.1,
        objectives: Vec::new(),
        objectives_below_sigma: 0.3,
        tasks: TaskWeights::default(),
        balance: Balance::Places,
        batch_size: 8,
        max_agents: 16,
        max_lanes: 48,
        n_eval_scenes: 48,
        fit: schedule(8_000, 1e-3, 200, 500),
    }
}

/// The geometric network with these layers.
fn geometric(layers: &str, width: usize, n_heads: usize) -> NetworkConfig {
    NetworkConfig {
        layers: layers.to_owned(),
        width,
        n_heads,
        feed_forward: 4 * width,
        geometry: Some(GeometryConfig { relation_width: width / 2, ..GeometryConfig::default() }),
        ..NetworkConfig::default()
    }
}

/// A schedule with a cosine decay.
fn schedule(steps: u64, learning_rate: f64, warmup_steps: u64, every: u64) -> FitConfig {
    FitConfig {
        steps,
        learning_rate,
        warmup_steps,
        decay: LearningRateDecay::Cosine,
        clip_norm: 5.0,
        ema_decay: 0.99,
        evaluate_every: every,
        save_every: every / 2,
        log_every: 20,
    }
}
