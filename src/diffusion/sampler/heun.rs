//! Heun's second-order sampler: EDM's algorithm 1, the paper's choice.

use super::{Observer, Step, denoise_at, slope, steps};
use crate::diffusion::Denoiser;
use candle_core::{Result, Tensor};

/// See [`super::SamplerConfig::integrate`].
pub(super) fn integrate(
    sigmas: &[f64],
    denoiser: &dyn Denoiser,
    mut x: Tensor,
    observer: &mut Observer<'_>,
) -> Result<Tensor> {
    let n_steps = sigmas.len().saturating_sub(1);
    for (step_idx, sigma, sigma_next) in steps(sigmas) {
        // Euler step.
        let x0_hat = denoise_at(denoiser, &x, sigma)?;
        let slope_here = slope(&x, &x0_hat, sigma)?;
        let step = sigma_next - sigma;
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
