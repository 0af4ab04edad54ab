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
/// Where J is curved, that full step overshoots, and a wish that only a guided sample violates (not to move over too
/// fast) has no gradient yet. The mode of the tilted posterior is looked for instead: x₀ = D + C w with the w that
/// maximizes F(w) = α J(D + C w) - ½ w · C w, which is w = α ∇J where J is linear. From w = 0, each step goes along
/// α ∇J - w, the gradient of F in the metric of C, by as much as the last change of this gradient asks for (Barzilai
/// and Borwein 1988), less if F would fall. The first goes by 1 / (1 + α ∇J · C ∇J / (2 |J|)): J ≈ -½ k (c · x₀ - b)²
/// obeys ∇J · C ∇J = 2 |J| k c · C c, so this gives its exact answer D + α C ∇J / (1 + α k c · C c) without knowing k
/// and c. It supposes J ≤ 0 with 0 as the best. The network is not evaluated again.
pub struct CleanGuidedDenoiser<'a> {
    /// The denoiser that is guided; it may be guided otherwise already.
    pub inner: &'a dyn Denoiser,
    /// The potential.
    pub potential: &'a dyn CleanPotential,
    /// Strength α; 0 changes nothing.
    pub strength: f64,
    /// When guidance acts and how far it may go.
    pub gate: GuidanceConfig,
    /// Whether the mode is looked for. Otherwise the first step is all: agents that are only kept from collisions
    /// should not dodge everybody who drives into them.
    pub to_mode: bool,
    /// The modes of clean samples, where they are known; without them, entries are independent, of variance σ_data².
    pub modes: Option<&'a Surroundings>,
}

/// How often the potential is evaluated after a step at most.
const N_STEPS: usize = 20;
/// Steps end where the gradient of F has fallen to this share of the first, squared.
const CONVERGED: f64 = 1e-4;
/// F may fall by this share of it, which single precision does not know; a step that lets it fall is shortened to this
/// share.
const ROUNDING: f64 = 1e-6;
const SHORTER: f64 = 0.25;

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

    /// The shift C w of each row, with the w that maximizes F.
    fn shift(&self, estimate: &Estimate<'_>, x0_hat: &Tensor, strengths: &[f64]) -> Result<Tensor> {
        let mut at = self.ascent(estimate, x0_hat, strengths, &x0_hat.zeros_like()?)?;
        let first = at.squares.clone();
        let damped = |(square, value): (&f64, &f64)| {
            let bend = square / (2.0 * value.abs());
            // It is undefined where the potential is at its best.
            if bend.is_finite() && bend > 0.0 { 1.0 / (1.0 + bend) } else { 1.0 }
        };
        let mut steps: Vec<f64> = first.iter().zip(&at.values).map(damped).collect();
        if !self.to_mode {
            return at.pushes.broadcast_mul(&rows_like(steps, x0_hat)?);
        }
        for _ in 0..N_STEPS {
            let is_open: Vec<bool> =
                at.squares.iter().zip(&first).map(|(now, first)| *now > CONVERGED * first).collect();
            if !is_open.contains(&true) {
                break;
            }
            let by = steps.iter().zip(&is_open).map(|(step, is_open)| if *is_open { *step } else { 0.0 }).collect();
            let w = (&at.w + at.direction.broadcast_mul(&rows_like(by, x0_hat)?)?)?;
            let then = self.ascent(estimate, x0_hat, strengths, &w)?;
            let crossed = dots(&then.direction, &at.pushes)?;
            let is_better = |row: usize| then.values[row] >= at.values[row] - ROUNDING * at.values[row].abs();
            let is_better: Vec<bool> = (0..steps.len()).map(is_better).collect();
            for (row, step) in steps.iter_mut().enumerate().filter(|(row, _)| is_open[*row]) {
                // The change of the gradient along the step, in shares of it.
                let change = 1.0 - crossed[row] / at.squares[row];
                *step *= if !is_better[row] {
                    SHORTER
                } else if change > 0.0 {
                    change.recip()
                } else {
                    1.0
                };
            }
            at = at.or(then, &is_better)?;
        }
        estimate.times_covariance(&at.w)
    }

    /// F and its gradient at `w`.
    fn ascent(&self, estimate: &Estimate<'_>, x0_hat: &Tensor, strengths: &[f64], w: &Tensor) -> Result<Ascent> {
        let shift = estimate.times_covariance(w)?;
        let (potential, gradient) = self.gradient(&(x0_hat + &shift)?)?;
        let direction = (gradient.broadcast_mul(&rows_like(strengths.to_vec(), w)?)? - w)?;
        let pushes = estimate.times_covariance(&direction)?;
        let (costs, squares) = (dots(w, &shift)?, dots(&direction, &pushes)?);
        let value = |row: usize| strengths[row] * potential[row] - costs[row] / 2.0;
        Ok(Ascent { w: w.clone(), values: (0..strengths.len()).map(value).collect(), direction, pushes, squares })
    }
}

/// F at w, and the way up.
struct Ascent {
    w: Tensor,
    /// F of each row.
    values: Vec<f64>,
    /// d = α ∇J - w, the gradient of F in the metric of C.
    direction: Tensor,
    /// C d.
    pushes: Tensor,
    /// d · C d of each row.
    squares: Vec<f64>,
}

impl Ascent {
    /// `then` in these rows, and this in the others.
    fn or(self, then: Self, rows: &[bool]) -> Result<Self> {
        let shape: Vec<usize> = (0..self.w.rank()).map(|dim| if dim == 0 { rows.len() } else { 1 }).collect();
        let taken: Vec<u8> = rows.iter().map(|row| u8::from(*row)).collect();
        let taken = Tensor::from_vec(taken, shape, self.w.device())?.broadcast_as(self.w.shape())?;
        let tensors = |old: &Tensor, new: &Tensor| taken.where_cond(new, old);
        let numbers = |old: Vec<f64>, new: Vec<f64>| {
            rows.iter().zip(old.into_iter().zip(new)).map(|(row, (old, new))| if *row { new } else { old }).collect()
        };
        Ok(Self {
            w: tensors(&self.w, &then.w)?,
            direction: tensors(&self.direction, &then.direction)?,
            pushes: tensors(&self.pushes, &then.pushes)?,
            values: numbers(self.values, then.values),
            squares: numbers(self.squares, then.squares),
        })
    }
}

/// a · b of each row.
fn dots(a: &Tensor, b: &Tensor) -> Result<Vec<f64>> {
    sigma_rows(&(a * b)?.flatten_from(1)?.sum(1)?)
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
        let shift = self.shift(&estimate, &x0_hat, &strengths)?;
        x0_hat + limit_norm(&shift, self.gate.max_shift)?
    }
}

#[cfg(test)]
mod tests;
