//! Euler's first-order sampler: the simplest, for comparison.

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
        let x0_hat = denoise_at(denoiser, &x, sigma)?;
        x = (&x + (slope(&x, &x0_hat, sigma)? * (sigma_next - sigma))?)?;
        observer(&Step { step_idx, n_steps, sigma, x: &x, x0_hat: &x0_hat });
    }
    Ok(x)
}
