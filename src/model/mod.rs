//! The networks: DJINN's scene denoiser, the behavior classifiers that guide it, and the Scene Transformer to compare
//! with.
//!
//! The denoiser has one of two networks. `network` is the paper's. `geometric_network` sees geometry in common frames:
//! at every noise level, a linear filter along the modes of motion turns the noisy states into a first estimate, which
//! is decoded to poses. `relations` looks up the nearest neighbors and lanes of each agent at those poses, on the host
//! and outside every gradient.

mod behavior_classifier;
mod classifier_checkpoint;
mod denoiser_checkpoint;
mod geometric_network;
#[cfg(test)]
mod geometric_tests;
mod known_input;
mod named_edm;
mod network;
mod relations;
mod scene_denoiser;
mod scene_transformer;
mod scene_transformer_checkpoint;
#[cfg(test)]
mod scene_transformer_tests;
#[cfg(test)]
mod tests;
mod trained;
mod trunk;

pub use behavior_classifier::{BehaviorClassifier, BehaviorClassifierConfig, log_sigmoid};
pub use classifier_checkpoint::{ClassifierKind, ClassifierSpec, TrainedClassifier};
pub use denoiser_checkpoint::{
    ChangedLoss, DenoiserKind, DenoiserSpec, Distillation, PlaceLoss, SceneChange, TrainedDenoiser,
};
pub use network::{GeometryConfig, NetworkConfig, SceneNetwork};
pub use scene_denoiser::{BoundDenoiser, SceneDenoiser};
pub use scene_transformer::{JointFutures, SceneTransformer, SceneTransformerConfig};
pub use scene_transformer_checkpoint::{SceneTransformerKind, SceneTransformerSpec, TrainedSceneTransformer};
pub use trained::{ModelSpec, TrainedModel};
