//! Euler's first-order sampler: the simplest, for comparison.

use super::{Observer, Step, StepGrid, denoise_at, slope, steps};
use crate::diffusion::Denoiser;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of Euler's sampler.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EulerConfig {
    /// Number of steps N, one evaluation each.
    #[schemars(range(min = 1, max = 10_000))]
    pub n_steps: usize,
    /// The grid of noise levels, if it is not the denoiser's.
    pub grid: StepGrid,
}

impl Default for EulerConfig {
    fn default() -> Self {
        Self { n_steps: 100, grid: StepGrid::default() }
    }
}

/// See [`super::SamplerConfig::integrate`].
pub(super) fn integrate(
    sigmas: &[f64],
    denoiser: &dyn Denoiser,
    mut x: Tensor,
    observer: &mut Observer<'_>,
) -> Result<Tensor> {
    let n_steps = sigmas.len().saturating_sub(1);
    for (step_idx, sigma, sigma_next) in steps(sigmas) {
        let x0_hat = denoise_at(denoiser, &x, sigma)?;
        x = (&x + (slope(&x, &x0_hat, sigma)? * (sigma_next - sigma))?)?;
        observer(&Step { step_idx, n_steps, sigma, x: &x, x0_hat: &x0_hat });
    }
    Ok(x)
}
