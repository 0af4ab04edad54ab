//! The `[train.distill]` section: distillation of a denoiser into one that needs few evaluations.

use super::objective_loss::check_objectives;
use super::section::{Own, SceneTraining, scene_training_section};
use super::{Error, FitConfig, StepDistillation};
use crate::diffusion::Edm;
use crate::guidance::ObjectiveConfig;
use crate::model::{DenoiserSpec, Distillation};
use crate::settings::Issue;
use crate::tensor::TaskWeights;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

impl StepDistillation {
    /// The description in the checkpoint.
    pub fn distillation(&self, edm: &Edm) -> Distillation {
        Distillation::Steps { sigmas: self.sigmas(edm) }
    }

    /// Fails if the steps do not fit the denoiser.
    pub(super) fn check(&self, teacher: &DenoiserSpec) -> Result<(), Error> {
        if teacher.distillation.is_some() {
            let why = "needs an ordinary denoiser, but this one is already distilled and does not predict means";
            return Err(DistillTrainingConfig::refusal(Issue::new("method", why)));
        }
        self.check_levels(&teacher.edm).map_err(refused)
    }
}

fn refused(issue: Issue) -> Error {
    DistillTrainingConfig::refusal(issue.within("method"))
}

/// The learning rate of distillation, and the steps over which it rises from 0: those of further training, because the
/// student begins with the weights of the denoiser.
const LEARNING_RATE: f64 = 3e-4;
const WARMUP_STEPS: u64 = 50;

scene_training_section! {
    /// How to distill a trained denoiser into one of the same network, scales and masks that needs few evaluations.
    pub struct DistillTrainingConfig in "train.distill", each Own {
        /// A few large steps that match many small ones of the denoiser: for sweeps with `sampler = { kind = "euler" }`
        /// of the same `n_steps` and `grid`.
        pub method: StepDistillation,
        /// Objectives for samples, in addition to matching the denoiser: each adds its weight
        /// times its cost beyond that of the recording, √(1 - 2 J) - 1 per scene.
        pub objectives: Vec<ObjectiveConfig>,
    }
}

impl Default for DistillTrainingConfig {
    fn default() -> Self {
        Self {
            method: StepDistillation::default(),
            objectives: Vec::new(),
            tasks: TaskWeights::default(),
            data: Vec::new(),
            own_weight: None,
            calibrate: false,
            steps: 2_000,
            batch_size: 8,
            evaluate_every: 500,
            checkpoint: None,
        }
    }
}

/// The resolved section, with every value decided.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DistillTraining {
    /// The steps.
    pub method: StepDistillation,
    /// The objectives for samples.
    pub objectives: Vec<ObjectiveConfig>,
    /// Tasks, batches, evaluations and the schedule.
    pub common: SceneTraining,
}

impl DistillTrainingConfig {
    /// The settings of the training.
    pub fn resolve(&self) -> Result<DistillTraining, Error> {
        self.check_ranges()?;
        self.method.validate().map_err(refused)?;
        check_objectives("train.distill.objectives", &self.objectives)?;
        let fit = FitConfig { learning_rate: LEARNING_RATE, warmup_steps: WARMUP_STEPS, ..FitConfig::default() };
        Ok(DistillTraining {
            method: self.method.clone(),
            objectives: self.objectives.clone(),
            common: self.scene_training(&SceneTraining { fit, ..SceneTraining::default() })?,
        })
    }
}
