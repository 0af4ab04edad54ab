//! The `[train.baseline]` section: how is the Scene Transformer trained that the denoiser is compared with?

use super::{Error, FitConfig, LearningRateDecay, Preset};
use crate::model::SceneTransformerConfig;
use crate::scene::Split;
use crate::settings::{self, Issue};
use crate::tensor::{StateParametrization, TaskWeights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How to train Scene Transformer, the paper's baseline. What is left out is the preset's: but for the network, the same as
/// the denoiser's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BaselineTrainingConfig {
    /// Size of the network: `tiny`, `small` or `paper`.
    pub preset: Preset,
    /// The network, where the preset's does not fit.
    pub network: Option<SceneTransformerConfig>,
    /// What the network puts out: `scene`, `residual` or `motion`.
    pub state_parametrization: Option<StateParametrization>,
    /// Weight of -ln p of the best future in the loss, beside its mean error.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub mode_loss: f64,
    /// How often each observation task is drawn; `{ predictive = 1.0, goal_conditioned = 0.0, … }` trains for prediction alone.
    pub tasks: TaskWeights,
    /// Splits to train on; empty means `train`, or everything unsplit where there is no such split.
    pub splits: Vec<Split>,
    /// Places to train on; empty means all.
    pub places: Vec<String>,
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
    /// Dimensions of a predicted state: 3 (x, y, heading) or 2 (x, y). Left out: 2 for Argoverse 1, else 3.
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
    /// A trained checkpoint to use instead of training.
    pub checkpoint: Option<std::path::PathBuf>,
}

impl Default for BaselineTrainingConfig {
    fn default() -> Self {
        Self {
            preset: Preset::default(),
            network: None,
            state_parametrization: None,
            mode_loss: 1.0,
            tasks: TaskWeights::default(),
            splits: Vec::new(),
            places: Vec::new(),
            steps: None,
            batch_size: None,
            learning_rate: None,
            warmup_steps: None,
            decay: None,
            clip_norm: None,
            ema_decay: None,
            max_agents: None,
            max_lanes: None,
            state_dim: None,
            n_eval_scenes: None,
            evaluate_every: None,
            save_every: None,
            checkpoint: None,
        }
    }
}

/// The same with every value decided.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BaselineTraining {
    /// The network.
    pub network: SceneTransformerConfig,
    /// What the network puts out.
    pub parametrization: StateParametrization,
    /// Weight of -ln p of the best future in the loss.
    pub mode_loss: f64,
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
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

impl BaselineTrainingConfig {
    /// The preset with everything that the section says laid over it.
    ///
    /// # Errors
    /// When a value makes no sense, naming it.
    pub fn resolve(&self) -> Result<BaselineTraining, Error> {
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
        let training = BaselineTraining {
            network: self.network.clone().unwrap_or_else(|| network(self.preset)),
            parametrization: self.state_parametrization.unwrap_or(base.parametrization),
            mode_loss: self.mode_loss,
            tasks: self.tasks,
            batch_size: self.batch_size.unwrap_or(base.batch_size),
            max_agents: self.max_agents.unwrap_or(base.max_agents),
            max_lanes: self.max_lanes.unwrap_or(base.max_lanes),
            n_eval_scenes: self.n_eval_scenes.unwrap_or(base.n_eval_scenes),
            fit,
        };
        let within = |issue: Issue| Error::Config(issue.within("train.baseline").to_string());
        settings::check_ranges(self).map_err(within)?;
        training.network.validate().map_err(|issue| within(issue.within("network")))?;
        if self.tasks.probabilities().is_none() {
            let message = "train.baseline.tasks are no weights: give numbers of at least 0, one of them positive";
            return Err(Error::Config(message.to_owned()));
        }
        Ok(training)
    }
}

/// The network of a preset: about as large as the preset's denoiser.
fn network(preset: Preset) -> SceneTransformerConfig {
    let smaller = |encoder: &str, decoder: &str, width, n_heads, encoding| SceneTransformerConfig {
        encoder: encoder.to_owned(),
        decoder: decoder.to_owned(),
        width,
        n_heads,
        feed_forward: 4 * width,
        encoding,
        ..SceneTransformerConfig::default()
    };
    match preset {
        Preset::Tiny => smaller("TAM", "TA", 32, 2, 16),
        Preset::Small | Preset::PaperSmall => smaller("TATM TA", "TA", 96, 4, 32),
        Preset::Large | Preset::Paper => SceneTransformerConfig::default(),
    }
}
