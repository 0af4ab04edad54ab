//! The networks: DJINN's scene denoiser and the behavior classifiers that guide it.

mod network;
mod scene_denoiser;

pub use network::{NetworkConfig, SceneNetwork};
pub use scene_denoiser::{BoundDenoiser, SceneDenoiser};
