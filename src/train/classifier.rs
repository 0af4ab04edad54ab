//! From mined pairs to a classifier checkpoint: balance, network, training, file, report.

use super::section::{Own, training_section};
use super::{
    ClassificationTask, Error, FitConfig, FitStatistics, LabeledPair, NoiseLevelReport, NoisyPairs, PairExamples,
    SceneDataset, TrainJob, TrainOutcome, Trainable, fit,
};
use crate::diffusion::NoiseDistribution;
use crate::files::write_atomically;
use crate::model::{BehaviorClassifierConfig, ClassifierKind, ClassifierSpec, DenoiserSpec};
use crate::seed::Seed;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::sync::Mutex;

/// Pairs to train on at most; negative ones are dropped first, until half are positive. They are held in memory, some
/// kilobytes each.
pub const MAX_EXAMPLES: usize = 50_000;
/// Held-out pairs of an evaluation at most: enough for two digits of every figure.
pub const MAX_HELD_OUT: usize = 4_000;
/// Steps over which the learning rate rises from 0.
const WARMUP_STEPS: u64 = 100;

training_section! {
    /// How to train the classifier of a behavior: the `[train.classifier]` section.
    pub struct ClassifierTrainingConfig in "train.classifier", each Own {
        /// Name of the behavior, which must be mined.
        pub behavior: String,
        /// Places to train on. Empty: those of `train.places`.
        #[schemars(extend("uniqueItems" = true))]
        pub places: Vec<String>,
    }
}

impl Default for ClassifierTrainingConfig {
    fn default() -> Self {
        Self {
            behavior: "cut_in".to_owned(),
            places: Vec::new(),
            steps: 6_000,
            batch_size: 128,
            evaluate_every: 1_000,
            checkpoint: None,
        }
    }
}

impl ClassifierTrainingConfig {
    /// The loop's settings.
    pub fn resolve(&self) -> Result<FitConfig, Error> {
        self.check_ranges()?;
        Ok(self.schedule(&FitConfig { ema_decay: 0.0, warmup_steps: WARMUP_STEPS, ..FitConfig::default() }))
    }
}

/// The pairs of a training run.
pub struct PairData<'a> {
    /// Roles of the behavior: one or two.
    pub roles: Vec<String>,
    /// The scenes of all pairs.
    pub dataset: &'a dyn SceneDataset,
    /// Pairs to train on.
    pub train: &'a [LabeledPair],
    /// Held-out pairs.
    pub held_out: &'a [LabeledPair],
    /// Fingerprint of the events.
    pub fingerprint: String,
}

/// The report on a trained classifier: the content of `classifier.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClassifierReport {
    /// The specification of the classifier.
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

/// Trains the classifier that guides `denoiser`, or resumes its training, and writes it to `model.safetensors` in the
/// job's folder, and its report to `classifier.json`.
///
/// # Errors
/// When there are no pairs of one of the labels, or training fails.
pub fn train_classifier(
    config: &ClassifierTrainingConfig,
    denoiser: &DenoiserSpec,
    data: &PairData<'_>,
    job: TrainJob<'_>,
) -> Result<ClassifierReport, Error> {
    let fit_config = config.resolve()?;
    let spec = describe(config, denoiser, data, job.seed)?;
    let gather = |pairs| PairExamples::gather(data.dataset, pairs);
    let (train, held_out) = (gather(data.train)?, gather(data.held_out)?);
    // The paper's, as for its denoiser.
    let (noise, device) = (NoiseDistribution::default(), &job.compute.device);
    let inputs = NoisyPairs { spec: &spec, noise, train: &train, held_out: &held_out, device };
    let mut model = Trainable::new(&spec, None, job)?;
    let task = ClassificationTask {
        classifier: &model.network,
        frozen: &model.frozen,
        inputs: &inputs,
        pos_weight: spec.pos_weight,
        batch_size: config.batch_size,
        seed: job.seed,
        ahead: Mutex::default(),
    };
    let outcome = fit(&fit_config, &mut model.params, &task, job)?;
    let by_noise_level = task.report()?;
    let TrainOutcome { fingerprint, spec, n_parameters, statistics } = model.finish(spec.clone(), outcome, job)?;
    let report = ClassifierReport { spec, fingerprint, n_parameters, by_noise_level, statistics };
    let text = serde_json::to_vec_pretty(&report).map_err(std::io::Error::from)?;
    write_atomically::<Error>(&job.dir.join("classifier.json"), |file| Ok(file.write_all(&text)?))?;
    Ok(report)
}

fn describe(
    config: &ClassifierTrainingConfig,
    denoiser: &DenoiserSpec,
    data: &PairData<'_>,
    seed: Seed,
) -> Result<ClassifierSpec, Error> {
    let n_positive = data.train.iter().filter(|pair| pair.is_positive).count();
    let n_negative = data.train.len() - n_positive;
    if n_positive == 0 || n_negative == 0 {
        return Err(Error::NoExamples { behavior: config.behavior.clone(), n_positive, n_negative });
    }
    Ok(ClassifierSpec {
        kind: ClassifierKind::BehaviorClassifier,
        behavior: config.behavior.clone(),
        roles: data.roles.clone(),
        network: BehaviorClassifierConfig::default(),
        edm: denoiser.edm,
        normalizer: denoiser.normalizer.clone(),
        n_history: denoiser.n_history,
        n_timesteps: denoiser.n_timesteps,
        dt_s: denoiser.dt_s,
        n_positive: n_positive as u64,
        n_negative: n_negative as u64,
        // Balances the labels.
        pos_weight: n_negative as f64 / n_positive as f64,
        steps: config.steps,
        seed: seed.0,
        events: data.fingerprint.clone(),
    })
}
