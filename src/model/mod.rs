//! The networks: DJINN's scene denoiser and the behavior classifiers that guide it.

mod denoiser_checkpoint;
mod network;
mod scene_denoiser;
#[cfg(test)]
mod tests;

pub use denoiser_checkpoint::{DenoiserKind, DenoiserSpec, TrainedDenoiser};
pub use network::{NetworkConfig, SceneNetwork};
pub use scene_denoiser::{BoundDenoiser, SceneDenoiser};
