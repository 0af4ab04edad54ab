//! DPM-Solver++(2M): second order with one evaluation a step, by reusing the previous clean estimate.
//!
//! Lu et al. 2022, "DPM-Solver++: Fast Solver for Guided Sampling of Diffusion Probabilistic Models", algorithm 2. With
//! EDM's noise process (no scaling of the data, standard deviation σ) the half log-SNR is λ = -ln σ, and one step from σ
//! to σ' of length h = λ' - λ reads x' = (σ' / σ) x + (1 - σ' / σ) D, where D extrapolates the estimates to the middle of
//! the step.
//!
//! With η > 0 it solves the reverse stochastic equation instead, whose distributions at each noise level are the same: it
//! forgets noise faster, by the factor exp(-(1 + η) h), and adds as much noise as is then missing. η = 1 is the paper's
//! SDE-DPM-Solver++(2M).

use super::resampler::resample;
use super::{Observer, Resampler, Step, StepGrid, denoise_at, steps};
use crate::diffusion::{Denoiser, NoiseSource};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of DPM-Solver++(2M).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Dpmpp2mConfig {
    /// Number of steps N, one evaluation each.
    #[schemars(range(min = 1, max = 10_000))]
    pub n_steps: usize,
    /// How much noise η is added on the way: 0 for none, 1 for the reverse stochastic equation. Particles need some.
    #[schemars(range(min = 0.0, max = 10.0))]
    #[serde(skip_serializing_if = "is_zero")]
    pub eta: f64,
    /// The grid of noise levels, if it is not the denoiser's.
    pub grid: StepGrid,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Default for Dpmpp2mConfig {
    fn default() -> Self {
        Self { n_steps: 40, eta: 0.0, grid: StepGrid::default() }
    }
}

/// See [`super::SamplerConfig::integrate`].
pub(super) fn integrate(
    config: &Dpmpp2mConfig,
    sigmas: &[f64],
    denoiser: &dyn Denoiser,
    mut x: Tensor,
    noise: &mut NoiseSource,
    resampler: &mut Resampler<'_>,
    observer: &mut Observer<'_>,
) -> Result<Tensor> {
    let n_steps = sigmas.len().saturating_sub(1);
    // The length of the previous step in λ, and the estimate it began with.
    let mut previous: Option<(f64, Tensor)> = None;
    for (step_idx, sigma, sigma_next) in steps(sigmas) {
        let mut x0_hat = denoise_at(denoiser, &x, sigma)?;
        if config.eta > 0.0 {
            let before = previous.as_mut().map(|(_, x0_hat)| x0_hat);
            let mut others: Vec<&mut Tensor> = [&mut x].into_iter().chain(before).collect();
            resample(resampler, (sigma, sigma_next > 0.0), &mut x0_hat, &mut others)?;
        }
        let ratio = sigma_next / sigma;
        let h = -ratio.ln();
        // What is left of the noise: σ'/σ of it, and with η more of it is forgotten than that.
        let kept = ratio.powf(config.eta);
        let target = match &previous {
            // The step to σ = 0 is infinitely long in λ: there the estimate itself is the answer.
            Some((h_previous, x0_hat_previous)) if sigma_next > 0.0 => {
                let share = h / (2.0 * h_previous);
                ((&x0_hat * (1.0 + share))? - (x0_hat_previous * share)?)?
            }
            _ => x0_hat.clone(),
        };
        x = ((&x * (ratio * kept))? + (target * (1.0 - ratio * kept))?)?;
        let added = sigma_next * (1.0 - kept.powi(2)).max(0.0).sqrt();
        if added > 0.0 {
            x = (&x + (noise.draw_like(&x)? * added)?)?;
        }
        observer(&Step { step_idx, n_steps, sigma, x: &x, x0_hat: &x0_hat });
        previous = Some((h, x0_hat));
    }
    Ok(x)
}
