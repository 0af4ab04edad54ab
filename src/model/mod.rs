//! The networks: DJINN's scene denoiser and the behavior classifiers that guide it.

mod behavior_classifier;
mod classifier_checkpoint;
mod denoiser_checkpoint;
mod network;
mod scene_denoiser;
#[cfg(test)]
mod tests;

pub use behavior_classifier::{BehaviorClassifier, BehaviorClassifierConfig, log_sigmoid};
pub use classifier_checkpoint::{ClassifierKind, ClassifierSpec, TrainedClassifier};
pub use denoiser_checkpoint::{DenoiserKind, DenoiserSpec, TrainedDenoiser};
pub use network::{NetworkConfig, SceneNetwork};
pub use scene_denoiser::{BoundDenoiser, SceneDenoiser};
