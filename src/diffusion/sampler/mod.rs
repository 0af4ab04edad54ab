//! Turns noise into samples: the list of samplers, and what they have in common.

mod dpmpp_2m;
mod euler;
mod grid;
mod heun;
#[cfg(test)]
mod tests;

pub use dpmpp_2m::Dpmpp2mConfig;
pub use euler::EulerConfig;
pub use grid::StepGrid;
pub use heun::HeunConfig;

use super::{Denoiser, Edm, NoiseSource};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A sampler and its settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind")]
pub enum SamplerConfig {
    /// Second order, two evaluations per step; the paper's.
    #[serde(rename = "heun")]
    Heun(HeunConfig),
    /// First order, one evaluation per step.
    #[serde(rename = "euler")]
    Euler(EulerConfig),
    /// Second order, one evaluation per step (DPM-Solver++ 2M).
    #[serde(rename = "dpmpp_2m")]
    Dpmpp2m(Dpmpp2mConfig),
}

impl Default for SamplerConfig {
    fn default() -> Self {
        Self::Heun(HeunConfig::default())
    }
}

/// The state that an observer sees after each step.
#[derive(Debug)]
pub struct Step<'a> {
    /// Which step was just taken, from 0.
    pub step_idx: usize,
    /// Number of steps in all.
    pub n_steps: usize,
    /// The noise level that the step started from.
    pub sigma: f64,
    /// The state after the step, (B, …).
    pub x: &'a Tensor,
    /// The clean estimate that the step was taken with, (B, …).
    pub x0_hat: &'a Tensor,
}

/// Called after every step, for progress and for inspection.
pub type Observer<'a> = dyn FnMut(&Step<'_>) + 'a;

impl SamplerConfig {
    /// Number of steps N.
    pub const fn n_steps(&self) -> usize {
        match self {
            Self::Heun(config) => config.n_steps,
            Self::Euler(config) => config.n_steps,
            Self::Dpmpp2m(config) => config.n_steps,
        }
    }

    /// Number of evaluations of the denoiser for one sample. Heun's last step, to σ = 0, needs only one.
    pub const fn n_evaluations(&self) -> usize {
        match self {
            Self::Heun(config) => (2 * config.n_steps).saturating_sub(1),
            Self::Euler(_) | Self::Dpmpp2m(_) => self.n_steps(),
        }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// Names the setting that is invalid.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        self.grid().validate().map_err(|issue| issue.within("grid"))
    }

    /// The grid of noise levels, if it is not the denoiser's.
    const fn grid(&self) -> StepGrid {
        match self {
            Self::Heun(config) => config.grid,
            Self::Euler(config) => config.grid,
            Self::Dpmpp2m(config) => config.grid,
        }
    }

    /// The noise level that sampling begins with.
    pub fn sigma_start(&self, edm: &Edm) -> f64 {
        self.grid().laid_over(edm).sigma_max
    }

    /// The noise levels of its steps from `sigma_start`, the last of them 0.
    pub fn schedule(&self, edm: &Edm, sigma_start: f64) -> Vec<f64> {
        let edm = self.grid().laid_over(edm);
        // An edit may begin at or below the last level of the grid: there is one step then, to 0.
        match sigma_start <= edm.sigma_min {
            true => vec![sigma_start, 0.0],
            false => edm.schedule_from(sigma_start, self.n_steps()),
        }
    }

    /// The name for provenance: the kind, the number of steps and, if it is not the default, the grid: such as
    /// `heun-50`.
    pub fn name(&self) -> String {
        let name = match self {
            Self::Heun(config) if config.s_churn > 0.0 => format!("heun-{}-churn-{}", config.n_steps, config.s_churn),
            Self::Heun(config) => format!("heun-{}", config.n_steps),
            Self::Euler(config) => format!("euler-{}", config.n_steps),
            Self::Dpmpp2m(config) => format!("dpmpp_2m-{}", config.n_steps),
        };
        name + &self.grid().suffix()
    }

    /// One sample for each of `noise`'s rows: (B, `row_dims`…) in the dtype and on the device of `like`.
    pub fn sample(
        &self,
        edm: &Edm,
        denoiser: &dyn Denoiser,
        row_dims: &[usize],
        like: &Tensor,
        noise: &mut NoiseSource,
        observer: &mut Observer<'_>,
    ) -> Result<Tensor> {
        let sigma_start = self.sigma_start(edm);
        let x = (noise.draw(row_dims, like.dtype(), like.device())? * sigma_start)?;
        self.integrate(&self.schedule(edm, sigma_start), denoiser, x, noise, observer)
    }

    /// Integrates from `x` (B, …), a state at noise level `sigmas[0]`, along the decreasing `sigmas` to the last of
    /// them. The number of steps is that of `sigmas`. `noise` is drawn from only by samplers that add noise on the way.
    pub fn integrate(
        &self,
        sigmas: &[f64],
        denoiser: &dyn Denoiser,
        x: Tensor,
        noise: &mut NoiseSource,
        observer: &mut Observer<'_>,
    ) -> Result<Tensor> {
        match self {
            Self::Heun(config) => heun::integrate(config, sigmas, denoiser, x, noise, observer),
            Self::Euler(_) => euler::integrate(sigmas, denoiser, x, observer),
            Self::Dpmpp2m(_) => dpmpp_2m::integrate(sigmas, denoiser, x, observer),
        }
    }
}

/// D(x; σ) with the same noise level in every row, without the graph of a trainable network behind it: over many steps
/// that graph would keep the activations of every evaluation alive.
fn denoise_at(denoiser: &dyn Denoiser, x: &Tensor, sigma: f64) -> Result<Tensor> {
    let sigma = Tensor::full(sigma, x.dim(0)?, x.device())?.to_dtype(x.dtype())?;
    Ok(denoiser.denoise(x, &sigma)?.detach())
}

/// The slope dx/dσ = (x - D(x; σ)) / σ of the probability-flow equation (EDM, equation 3 in equation 1).
fn slope(x: &Tensor, x0_hat: &Tensor, sigma: f64) -> Result<Tensor> {
    (x - x0_hat)? / sigma
}

/// The pairs of neighboring noise levels, with their index.
fn steps(sigmas: &[f64]) -> impl Iterator<Item = (usize, f64, f64)> {
    sigmas.windows(2).enumerate().map(|(step_idx, pair)| (step_idx, pair[0], pair[1]))
}
