//! A denoiser whose clean estimates are guided by potentials of clean samples, such as of decoded trajectories.

use super::guided_denoiser::limit_norm;
use super::objectives::nothing;
use super::{GuidanceConfig, ObjectiveConfig, SceneContext};
use crate::diffusion::{Denoiser, SIGMA_DATA, rows_like, sigma_rows};
use crate::nn::ops::mode_filter;
use crate::tensor::{SceneBatch, Surroundings};
use candle_core::{Error, Result, Tensor, Var};

/// A log potential of clean samples.
pub trait CleanPotential {
    /// The log potential J of each batch row, (B), higher is better. `x0` is (B, …). Differentiable in `x0`, row by
    /// row.
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor>;
}

/// The weighted sum of objectives on the trajectories that diffused states stand for: Σ weight · J(decode(x₀)).
#[derive(Clone, Copy)]
pub struct ObjectiveSum<'a> {
    /// The objectives.
    pub objectives: &'a [ObjectiveConfig],
    /// The batch that is sampled, one row a sample.
    pub batch: &'a SceneBatch,
    /// The context of the batch for objectives.
    pub context: &'a SceneContext,
}

impl ObjectiveSum<'_> {
    /// The summands weight · J(decode(x₀)), each (B), in the order of the objectives.
    pub fn terms(&self, x0: &Tensor) -> Result<Vec<Tensor>> {
        let states = self.batch.decode(x0)?;
        let term = |objective: &ObjectiveConfig| {
            let potential = objective.log_potential(&states, self.context)?;
            nothing(&states)? + (potential * objective.weight)?
        };
        self.objectives.iter().map(term).collect()
    }
}

impl CleanPotential for ObjectiveSum<'_> {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        let zero = Tensor::zeros(x0.dim(0)?, x0.dtype(), x0.device())?;
        self.terms(x0)?.into_iter().try_fold(zero, |total, term| total + term)
    }
}

/// D'(x; σ) = D(x; σ) + α C(σ) ∇J(x₀) at x₀ = D(x; σ), with C the covariance of x₀ given x.
///
/// The objective is a likelihood p(y | x₀) ∝ exp(J(x₀)) of the *clean* sample. Sampling needs the noisy one, p(y | x) =
/// E[exp(J(x₀)) | x]. To first order around the posterior mean, J(x₀) ≈ J(D) + ∇J · (x₀ - D), and x₀ is about normal
/// given x, so ln p(y | x) ≈ J(D(x)) + ½ ∇J · C ∇J; the tilted posterior exp(∇J · x₀) p(x₀ | x) has the mean D + C ∇J,
/// which is what the guided denoiser must return. The same follows from the chain rule: D' = D + σ² ∇ₓ ln p(y | x) and
/// ∇ₓ J(D(x)) = (∂D/∂x)ᵀ ∇J, with σ² ∂D/∂x = C exactly (Tweedie's formula, second order). For Gaussian data of
/// covariance Uᵀ Λ U, C = Uᵀ (σ² λ / (σ² + λ)) U and nothing is approximate if J is linear; this C is used for all
/// data, because it needs no derivative of the network. Traffic has little variance in modes that change from timestep
/// to timestep, so it is pushed along its motion: aside without a jolt.
///
/// Where J is curved, the full step overshoots: near D, J ≈ -½ k (c · x₀ - b)² has the exact answer D + α C ∇J / (1 + α
/// k c · C c). Such a J obeys ∇J · C ∇J = 2 |J| k c · C c, so the factor 1 / (1 + α ∇J · C ∇J / (2 |J|)) gives it
/// without knowing k and c; it supposes J ≤ 0 with 0 as the best.
pub struct CleanGuidedDenoiser<'a> {
    /// The denoiser that is guided; it may be guided otherwise already.
    pub inner: &'a dyn Denoiser,
    /// The potential.
    pub potential: &'a dyn CleanPotential,
    /// Strength α; 0 changes nothing.
    pub strength: f64,
    /// When guidance acts and how far it may go.
    pub gate: GuidanceConfig,
    /// The modes of clean samples, where they are known; without them, entries are independent, of variance σ_data².
    pub modes: Option<&'a Surroundings>,
}

/// The estimate of the inner denoiser, and the factor by which gradients are multiplied by its covariance.
enum Estimate<'a> {
    /// The estimate, and σ² σ_data² / (σ² + σ_data²) of each row.
    Independent(Tensor, Tensor),
    /// The estimate, the modes U, (B, A, D, T, T), and σ² λ / (σ² + λ), (B, A, D, T).
    InModes(Tensor, &'a Tensor, Tensor),
}

impl Estimate<'_> {
    /// The estimate, detached from its graph.
    fn x0_hat(&self) -> Tensor {
        let (Self::Independent(x0_hat, _) | Self::InModes(x0_hat, ..)) = self;
        x0_hat.detach()
    }

    /// C g.
    fn times_covariance(&self, gradient: &Tensor) -> Result<Tensor> {
        match self {
            Self::Independent(_, weight) => gradient.broadcast_mul(weight),
            Self::InModes(_, modes, gains) => mode_filter(gradient, modes, gains),
        }
    }
}

impl CleanGuidedDenoiser<'_> {
    fn estimate(&self, x: &Tensor, sigma: &Tensor) -> Result<Estimate<'_>> {
        let rows = |value: &dyn Fn(f64) -> f64| rows_like(sigma_rows(sigma)?.into_iter().map(value).collect(), x);
        match self.modes {
            Some(Surroundings { modes, variances, .. }) => {
                let noise = rows(&|sigma| sigma.powi(2))?;
                let gains = variances.broadcast_mul(&noise)?.div(&variances.broadcast_add(&noise)?)?;
                Ok(Estimate::InModes(self.inner.denoise(x, sigma)?, modes, gains))
            }
            None => {
                let data = SIGMA_DATA.powi(2);
                let weight = rows(&|sigma| sigma.powi(2) * data / (sigma.powi(2) + data))?;
                Ok(Estimate::Independent(self.inner.denoise(x, sigma)?, weight))
            }
        }
    }

    /// J of each row at `x0`, and its gradient.
    fn gradient(&self, x0: &Tensor) -> Result<(Vec<f64>, Tensor)> {
        let x0 = Var::from_tensor(&x0.detach())?;
        let potential = self.potential.log_potential(x0.as_tensor())?;
        let gradients = potential.sum_all()?.backward()?;
        let gradient = gradients.get(x0.as_tensor()).map(Tensor::detach).ok_or_else(|| {
            Error::Msg("the objective does not depend on the clean estimate; some operation cuts its gradient".into())
        })?;
        Ok((sigma_rows(&potential.detach())?, gradient))
    }
}

impl Denoiser for CleanGuidedDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let strength = |sigma| if self.gate.acts_at(sigma) { self.strength } else { 0.0 };
        let strengths: Vec<f64> = sigma_rows(sigma)?.into_iter().map(strength).collect();
        if strengths.iter().all(|strength| *strength == 0.0) {
            return self.inner.denoise(x, sigma);
        }
        let estimate = self.estimate(x, sigma)?;
        let x0_hat = estimate.x0_hat();
        let (potential, gradient) = self.gradient(&x0_hat)?;
        let push = estimate.times_covariance(&gradient)?;
        let products = sigma_rows(&(&gradient * &push)?.flatten_from(1)?.sum(1)?)?;
        let damping = |row: usize| {
            let bend = strengths[row] * products[row] / (2.0 * potential[row].abs());
            // It is undefined where the potential is at its best.
            if bend.is_finite() && bend > 0.0 { 1.0 / (1.0 + bend) } else { 1.0 }
        };
        let damping = rows_like((0..strengths.len()).map(damping).collect(), x)?;
        let shift = push.broadcast_mul(&rows_like(strengths, x)?)?.broadcast_mul(&damping)?;
        x0_hat + limit_norm(&shift, self.gate.max_shift)?
    }
}

#[cfg(test)]
mod tests;
