//! The pieces that objectives are made of: differentiable speeds, smooth norms, penalties, sums over rows.

use candle_core::{D, Result, Tensor};

/// Least value of a rounded norm: ‖v‖ has no gradient at zero.
const ROUNDING: f64 = 0.05;
/// The cost δ that is added to that of every moment, so that the power of a cost of 0 is finite.
const LEAST_COST: f64 = 0.01;
/// The excess of a speed across that costs ½ a second, m/s.
const HURRY_MPS: f64 = 0.1;
/// Less than the inverse fourth power of any cost.
const NO_MOMENT: f64 = 1e-30;

/// The positions (B, A, T, 2) of `states` (B, A, T, 3).
pub(super) fn positions(states: &Tensor) -> Result<Tensor> {
    states.narrow(D::Minus1, 0, 2)
}

/// The headings (B, A, T, 1) of `states` (B, A, T, 3).
pub(super) fn headings(states: &Tensor) -> Result<Tensor> {
    states.narrow(D::Minus1, 2, 1)
}

/// Forward differences of `x` (B, A, T, ..) along time, per second: (B, A, T - 1, ..).
pub(super) fn rate(x: &Tensor, dt_s: f64) -> Result<Tensor> {
    let n = x.dim(2)?.saturating_sub(1);
    (x.narrow(2, 1, n)? - x.narrow(2, 0, n)?)? * (1.0 / dt_s)
}

/// √(‖v‖² + r²) over the last dimension, with r = 0.05: the norm, rounded at zero so that it has a gradient there.
/// Never 0.
pub(super) fn norm(v: &Tensor) -> Result<Tensor> {
    (v.sqr()?.sum(D::Minus1)? + ROUNDING * ROUNDING)?.sqrt()
}

/// -(x / tolerance)² / 2, the log density of a normal distribution up to a constant.
pub(super) fn penalty(x: &Tensor, tolerance: f64) -> Result<Tensor> {
    x.sqr()? * (-0.5 / (tolerance * tolerance))
}

/// The log potential of moving across by `across_m` (B, T) with at most `most_mps`: -½ ∫ (max(|rate| - most, 0) / 0.1
/// m/s)² dt over the timesteps that count.
pub(super) fn unhurried(across_m: &Tensor, counts: &Tensor, most_mps: f64, dt_s: f64) -> Result<Tensor> {
    let n = across_m.dim(1)?.saturating_sub(1);
    let rate_mps = ((across_m.narrow(1, 1, n)? - across_m.narrow(1, 0, n)?)? * (1.0 / dt_s))?;
    let excess_mps = (rate_mps.abs()? - most_mps)?.relu()?;
    (penalty(&excess_mps, HURRY_MPS)? * counts.narrow(1, 1, n)?)?.sum(1)? * dt_s
}

/// The log potential of the best of the moments that count, smoothly: of `potentials`, each at most 0 and of the shape
/// of `counts`, the sum over them at that moment.
pub(super) fn best_potential(potentials: &[Tensor], counts: &Tensor) -> Result<Tensor> {
    let sum = potentials.iter().skip(1).try_fold(potentials[0].clone(), |sum, potential| sum + potential)?;
    best_moment(&sum.neg()?, counts)?.neg()
}

/// The cost of the best of the moments that count, smoothly: (Σ (c + δ)⁻⁴)^(-1/4) over the last dimension, 0 where no
/// moment counts. `costs` are at least 0; `counts` has the same shape, and is 0 or 1.
pub(super) fn best_moment(costs: &Tensor, counts: &Tensor) -> Result<Tensor> {
    let powers = (counts * (costs + LEAST_COST)?.powf(-4.0)?)?.sum(D::Minus1)?;
    let any = counts.sum(D::Minus1)?.minimum(1.0)?;
    (powers + NO_MOMENT)?.powf(-0.25)? * any
}

/// Σ over agents of ∫ `values` dt over the terms that count: `values` and `terms` (B, A, N), `agents` (B, A), to (B).
pub(super) fn integral(values: &Tensor, terms: &Tensor, agents: &Tensor, dt_s: f64) -> Result<Tensor> {
    let counted = (values * terms)?.sum(2)?;
    (counted * agents)?.sum(1)? * dt_s
}

/// 0 in each row, (B), that depends on `states` as gradients need it: backward passes do not follow a factor that is a
/// plain 0, so the zeros are a tensor.
pub(in crate::guidance) fn nothing(states: &Tensor) -> Result<Tensor> {
    let sums = states.flatten_from(1)?.sum(1)?;
    &sums * sums.zeros_like()?
}
