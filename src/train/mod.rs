//! Training: one resumable loop, and what it trains.

mod denoiser;
mod denoising;
mod error;
mod fit;
mod preset;

pub use denoiser::{DenoiserOutcome, TrainingData, train_denoiser};
pub use denoising::{DenoisingTask, SceneDataset};
pub use error::Error;
pub use fit::{FitConfig, FitOutcome, FitStatistics, LearningRateDecay, TrainTask, fit};
pub use preset::{DenoiserTraining, DenoiserTrainingConfig, Preset};
