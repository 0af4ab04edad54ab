//! Heun's second-order sampler with optional churn: EDM's algorithm 2, the paper's choice.

use super::{Observer, Step, StepGrid, denoise_at, slope, steps};
use crate::diffusion::{Denoiser, NoiseSource};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of Heun's sampler. Without churn it is deterministic given its starting noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HeunConfig {
    /// Number of steps N, of two evaluations each but for the last.
    #[schemars(range(min = 1, max = 10_000))]
    pub n_steps: usize,
    /// Amount S_churn of noise added anew over all steps, so much at each that the marginals stay what they are; 0 for
    /// none.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub s_churn: f64,
    /// The grid of noise levels, if it is not the denoiser's.
    pub grid: StepGrid,
}

impl Default for HeunConfig {
    fn default() -> Self {
        Self { n_steps: 50, s_churn: 0.0, grid: StepGrid::default() }
    }
}

impl HeunConfig {
    /// The deterministic sampler with this many steps.
    pub fn with_steps(n_steps: usize) -> Self {
        Self { n_steps, ..Self::default() }
    }

    /// The relative increase γ of each noise level in a run of `n_steps` steps. EDM's S_tmin, S_tmax and S_noise, which
    /// its authors tune for each data set of images, are 0, ∞ and 1.
    fn gamma(&self, n_steps: usize) -> f64 {
        (self.s_churn / n_steps as f64).min(std::f64::consts::SQRT_2 - 1.0)
    }
}

/// See [`super::SamplerConfig::integrate`].
pub(super) fn integrate(
    config: &HeunConfig,
    sigmas: &[f64],
    denoiser: &dyn Denoiser,
    mut x: Tensor,
    noise: &mut NoiseSource,
    observer: &mut Observer<'_>,
) -> Result<Tensor> {
    let n_steps = sigmas.len().saturating_sub(1);
    for (step_idx, sigma, sigma_next) in steps(sigmas) {
        // Increase the noise temporarily.
        let gamma = config.gamma(n_steps);
        let sigma_hat = sigma * (1.0 + gamma);
        if gamma > 0.0 {
            let added = (sigma_hat.powi(2) - sigma.powi(2)).sqrt();
            x = (&x + (noise.draw_like(&x)? * added)?)?;
        }
        // Euler step.
        let x0_hat = denoise_at(denoiser, &x, sigma_hat)?;
        let slope_here = slope(&x, &x0_hat, sigma_hat)?;
        let step = sigma_next - sigma_hat;
        let mut x_next = (&x + (&slope_here * step)?)?;
        // Second-order correction; at σ = 0 the slope is not defined.
        if sigma_next > 0.0 {
            let slope_next = slope(&x_next, &denoise_at(denoiser, &x_next, sigma_next)?, sigma_next)?;
            x_next = (x + ((slope_here + slope_next)? * (0.5 * step))?)?;
        }
        x = x_next;
        observer(&Step { step_idx, n_steps, sigma, x: &x, x0_hat: &x0_hat });
    }
    Ok(x)
}
