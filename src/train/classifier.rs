//! From mined pairs to a classifier checkpoint: balance, network, training, file, report.

use super::{
    ClassificationTask, Error, FitConfig, FitStatistics, LearningRateDecay, NoiseLevelReport, PairExamples, fit,
};
use crate::diffusion::NoiseDistribution;
use crate::files::write_atomically;
use crate::model::{BehaviorClassifierConfig, ClassifierKind, ClassifierSpec, DenoiserSpec};
use crate::nn::Params;
use crate::progress::Progress;
use crate::scene::Split;
use crate::seed::Seed;
use crate::settings;
use candle_core::Device;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// How to train the classifier of a behavior: the `[train.classifier]` section.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ClassifierTrainingConfig {
    /// Name of the behavior, which must be mined.
    pub behavior: String,
    /// The network.
    pub network: BehaviorClassifierConfig,
    /// How much more a positive pair counts in the loss than a negative one. Left out: the number of negative pairs over
    /// that of positive ones, so that both labels count the same.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub pos_weight: Option<f64>,
    /// Distribution of the training noise levels.
    pub noise: NoiseDistribution,
    /// Splits to train on; empty means `train`, or everything unsplit where there is no such split.
    pub splits: Vec<Split>,
    /// Places to train on; empty means all.
    pub places: Vec<String>,
    /// At most so many pairs to train on; negative ones are left out first.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub max_examples: usize,
    /// At most so many held-out pairs of each evaluation.
    #[schemars(range(max = 1_000_000_000))]
    pub max_held_out: usize,
    /// Optimizer steps in all.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub steps: u64,
    /// Pairs a step; half of them positive.
    #[schemars(range(min = 1, max = 16_384))]
    pub batch_size: usize,
    /// Learning rate after warm-up.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub learning_rate: f64,
    /// Steps over which the learning rate rises from 0.
    #[schemars(range(max = 1_000_000_000))]
    pub warmup_steps: u64,
    /// How the learning rate goes on: `constant` or `cosine`.
    pub decay: LearningRateDecay,
    /// Gradients are scaled down to this global norm.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub clip_norm: f64,
    /// Steps between evaluations.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub evaluate_every: u64,
    /// Steps between saved states.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub save_every: u64,
    /// A trained checkpoint to use instead of training.
    pub checkpoint: Option<PathBuf>,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for ClassifierTrainingConfig {
    fn default() -> Self {
        Self {
            behavior: "cut_in".to_owned(),
            network: BehaviorClassifierConfig::default(),
            pos_weight: None,
            noise: NoiseDistribution::default(),
            splits: Vec::new(),
            places: Vec::new(),
            max_examples: 50_000,
            max_held_out: 4_000,
            steps: 6_000,
            batch_size: 128,
            learning_rate: 1e-3,
            warmup_steps: 100,
            decay: LearningRateDecay::default(),
            clip_norm: 5.0,
            evaluate_every: 1_000,
            save_every: 500,
            checkpoint: None,
            seed: 0,
        }
    }
}

impl ClassifierTrainingConfig {
    /// The loop's settings.
    ///
    /// # Errors
    /// When a value makes no sense, naming it.
    pub fn resolve(&self) -> Result<FitConfig, Error> {
        settings::check_ranges(self).map_err(|issue| Error::Config(issue.within("train.classifier").to_string()))?;
        Ok(FitConfig {
            steps: self.steps,
            learning_rate: self.learning_rate,
            warmup_steps: self.warmup_steps,
            decay: self.decay,
            clip_norm: self.clip_norm,
            ema_decay: 0.0,
            evaluate_every: self.evaluate_every,
            save_every: self.save_every,
            log_every: 20,
        })
    }
}

/// The pairs of a training run.
pub struct PairData<'a> {
    /// Roles of the behavior: one or two.
    pub roles: Vec<String>,
    /// Pairs to train on.
    pub train: &'a PairExamples,
    /// Held-out pairs.
    pub held_out: &'a PairExamples,
    /// Fingerprint of the events.
    pub fingerprint: String,
}

/// What a trained classifier can do: the content of `classifier.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClassifierReport {
    /// What the classifier is.
    pub spec: ClassifierSpec,
    /// Fingerprint of the checkpoint.
    pub fingerprint: String,
    /// Number of trained values.
    pub n_parameters: usize,
    /// Figures on held-out pairs by noise level.
    pub by_noise_level: Vec<NoiseLevelReport>,
    /// Losses and evaluations during training.
    pub statistics: Vec<FitStatistics>,
}

/// Trains the classifier that guides `denoiser` in `dir` (resuming what is there), writes it to `dir/model.safetensors`
/// and what it can do to `dir/classifier.json`.
///
/// # Errors
/// When there are no pairs of one of the labels, or training fails.
pub fn train_classifier(
    config: &ClassifierTrainingConfig,
    denoiser: &DenoiserSpec,
    data: &PairData<'_>,
    dir: &Path,
    device: &Device,
    progress: &dyn Progress,
) -> Result<ClassifierReport, Error> {
    let fit_config = config.resolve()?;
    let seed = Seed(config.seed);
    let spec = describe(config, denoiser, data)?;
    let mut params = Params::new(device);
    let classifier = spec.build(&mut params, seed.derive("weights", &[]))?;
    let frozen = spec.build(&mut params.frozen(), seed)?;
    let task = ClassificationTask {
        classifier: &classifier,
        frozen: &frozen,
        spec: &spec,
        noise: config.noise,
        batch_size: config.batch_size,
        train: data.train,
        held_out: data.held_out,
        seed,
        device,
    };
    let outcome = fit(&fit_config, &mut params, &task, dir, progress)?;
    let by_noise_level = task.report()?;
    let report = ClassifierReport {
        fingerprint: spec.write(&params, &dir.join("model.safetensors"))?,
        n_parameters: params.n_parameters(),
        by_noise_level,
        statistics: outcome.statistics,
        spec,
    };
    let text = serde_json::to_vec_pretty(&report).map_err(std::io::Error::from)?;
    write_atomically::<Error>(&dir.join("classifier.json"), |file| Ok(file.write_all(&text)?))?;
    Ok(report)
}

fn describe(
    config: &ClassifierTrainingConfig,
    denoiser: &DenoiserSpec,
    data: &PairData<'_>,
) -> Result<ClassifierSpec, Error> {
    let (n_positive, n_negative) = (data.train.positive().len(), data.train.negative().len());
    if n_positive == 0 || n_negative == 0 {
        return Err(Error::NoExamples { behavior: config.behavior.clone(), n_positive, n_negative });
    }
    Ok(ClassifierSpec {
        kind: ClassifierKind::BehaviorClassifier,
        behavior: config.behavior.clone(),
        roles: data.roles.clone(),
        network: config.network.clone(),
        edm: denoiser.edm,
        normalizer: denoiser.normalizer.clone(),
        n_history: denoiser.n_history,
        n_timesteps: denoiser.n_timesteps,
        dt_s: denoiser.dt_s,
        n_positive: n_positive as u64,
        n_negative: n_negative as u64,
        pos_weight: config.pos_weight.unwrap_or(n_negative as f64 / n_positive as f64),
        steps: config.steps,
        seed: config.seed,
        events: data.fingerprint.clone(),
    })
}
