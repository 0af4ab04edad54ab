//! Training: one resumable loop for all models.
//!
//! The denoiser learns a mixture of observation tasks, the baseline the same draws, the classifier mined pairs in noisy
//! states, and the distilled denoiser a few large steps.

mod baseline;
mod baseline_config;
#[cfg(test)]
mod baseline_tests;
mod calibrate;
mod changed_losses;
mod classification;
#[cfg(test)]
mod classification_tests;
mod classifier;
mod classifier_report;
mod degraded;
mod denoiser;
mod denoiser_config;
#[cfg(test)]
mod denoiser_tests;
mod denoising;
mod distill;
mod distill_config;
#[cfg(test)]
mod distill_tests;
mod error;
mod fit;
mod fit_config;
mod joint_futures;
mod labeled_pairs;
mod latent_error;
mod objective_loss;
mod pace;
mod pair_examples;
mod preset;
mod run_state;
mod scene_draws;
#[cfg(test)]
mod scene_draws_tests;
mod scene_error;
mod section;
mod step_distillation;
mod task;
#[cfg(test)]
mod testing;
mod timed;
#[cfg(test)]
mod timed_tests;
mod trainable;
mod training_data;

pub use baseline::train_baseline;
pub use baseline_config::{BaselineTraining, BaselineTrainingConfig};
pub use calibrate::calibrate_denoiser;
pub use changed_losses::map_warnings;
pub use classification::{ClassificationTask, REPORT_SIGMAS};
pub use classifier::{
    ClassifierReport, ClassifierTrainingConfig, MAX_EXAMPLES, MAX_HELD_OUT, PairData, train_classifier,
};
pub use classifier_report::NoiseLevelReport;
pub use denoiser::train_denoiser;
pub use denoiser_config::{Balance, DenoiserTraining, DenoiserTrainingConfig, Scales, Within};
pub use denoising::{DenoisingTask, SCENE_ERROR};
pub use distill::distill_denoiser;
pub use distill_config::{DistillTraining, DistillTrainingConfig};
pub use error::Error;
pub use fit::{FitOutcome, FitStatistics, fit};
pub use fit_config::{FitConfig, LearningRateDecay};
pub use joint_futures::{JointFuturesTask, JointLoss};
pub use labeled_pairs::{LabeledPair, Labels, MinedEvent};
pub use pair_examples::{NoisyBatch, NoisyPairs, PairExample, PairExamples};
pub use preset::Preset;
pub use scene_draws::{DrawnBatch, Prefetched, SceneDataset, SceneDraws, WeightedGroups};
pub use section::{MoreScenes, OwnScenes, SceneChoice, SceneTraining};
pub use step_distillation::{StepDistillation, StepDistillationTask};
pub use task::TrainTask;
pub use timed::{CHOSEN_FILE, Chosen, Tried};
use trainable::Trainable;
pub use trainable::{JobTime, MODEL_FILE, TrainJob, TrainOutcome};
pub use training_data::{TrainingData, TrainingSource};
