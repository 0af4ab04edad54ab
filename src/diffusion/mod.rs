//! Diffusion of any tensor: noise levels, preconditioning, schedules, samplers. Knows tensors and σ, nothing of scenes.
//!
//! The design is EDM's (Karras et al. 2022, which the DJINN paper follows without modification): the forward process
//! adds Gaussian noise of standard deviation σ, so that diffusion time τ and noise level σ are the same number, and a
//! [`Denoiser`] estimates the clean tensor. Sampling integrates the probability-flow equation dx/dσ = (x - D(x; σ)) / σ
//! from `sigma_max` down to 0 along [`Edm::schedule`] with one of the [`sampler`]s. Anything that wraps a denoiser and
//! is one itself, such as guidance, works with every sampler.

#[cfg(test)]
pub(crate) mod analytic;
mod denoiser;
mod edm;
mod noise;
mod noise_level;
pub mod sampler;
mod schedule;

pub use denoiser::{Denoiser, rows_like, sigma_rows};
pub use edm::{Edm, SIGMA_DATA};
pub use noise::NoiseSource;
pub use noise_level::NoiseDistribution;
pub use sampler::{SamplerConfig, SamplerKind, Step};
pub use schedule::karras_schedule;
