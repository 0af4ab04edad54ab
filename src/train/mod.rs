//! Training: one resumable loop, and what it trains.

mod denoising;
mod error;
mod fit;
mod preset;

pub use denoising::{DenoisingTask, SceneDataset};
pub use error::Error;
pub use fit::{FitConfig, FitOutcome, LearningRateDecay, TrainTask, fit};
pub use preset::{DenoiserTraining, DenoiserTrainingConfig, Preset};
