//! Training: one resumable loop, and what it trains.

mod classification;
#[cfg(test)]
mod classification_tests;
mod classifier;
mod classifier_report;
mod denoiser;
mod denoising;
mod error;
mod fit;
mod pair_examples;
mod preset;
#[cfg(test)]
mod tests;

pub use classification::{ClassificationTask, REPORT_SIGMAS};
pub use classifier::{ClassifierReport, ClassifierTrainingConfig, PairData, train_classifier};
pub use classifier_report::NoiseLevelReport;
pub use denoiser::{DenoiserOutcome, TrainingData, train_denoiser};
pub use denoising::{DenoisingTask, SceneDataset};
pub use error::Error;
pub use fit::{FitConfig, FitOutcome, FitStatistics, LearningRateDecay, TrainTask, fit};
pub use pair_examples::{MinedEvent, PairExample, PairExamples};
pub use preset::{DenoiserTraining, DenoiserTrainingConfig, Preset};
