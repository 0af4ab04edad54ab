//! DPM-Solver++(2M): second order with one evaluation a step, by reusing the previous clean estimate.
//!
//! Lu et al. 2022, "DPM-Solver++: Fast Solver for Guided Sampling of Diffusion Probabilistic Models", algorithm 2. With
//! EDM's noise process (no scaling of the data, standard deviation σ) the half log-SNR is λ = -ln σ, and one step from
//! σ to σ' of length h = λ' - λ reads x' = (σ' / σ) x + (1 - σ' / σ) D, where D extrapolates the estimates to the
//! middle of the step.

use super::{Observer, Step, denoise_at, steps};
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
    // The length of the previous step in λ, and the estimate it began with.
    let mut previous: Option<(f64, Tensor)> = None;
    for (step_idx, sigma, sigma_next) in steps(sigmas) {
        let x0_hat = denoise_at(denoiser, &x, sigma)?;
        let ratio = sigma_next / sigma;
        let h = -ratio.ln();
        let target = match &previous {
            // The step to σ = 0 is infinitely long in λ: there the estimate itself is the answer.
            Some((h_previous, x0_hat_previous)) if sigma_next > 0.0 => {
                let share = h / (2.0 * h_previous);
                ((&x0_hat * (1.0 + share))? - (x0_hat_previous * share)?)?
            }
            _ => x0_hat.clone(),
        };
        x = ((&x * ratio)? + (target * (1.0 - ratio))?)?;
        observer(&Step { step_idx, n_steps, sigma, x: &x, x0_hat: &x0_hat });
        previous = Some((h, x0_hat));
    }
    Ok(x)
}
