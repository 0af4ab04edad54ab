//! Turns noise into samples: the list of samplers, and their common interface.

mod dpmpp_2m;
mod euler;
mod grid;
mod heun;
#[cfg(test)]
mod tests;

pub use grid::StepGrid;

use super::{Denoiser, Edm, NoiseSource};
use crate::settings::{self, named};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A sampler and its settings. All are deterministic given their starting noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SamplerConfig {
    /// The method.
    pub kind: SamplerKind,
    /// Number of steps. Left out: 50 of `heun`, 100 of `euler`, 40 of `dpmpp_2m`.
    #[schemars(range(min = 1, max = 10_000))]
    pub n_steps: Option<usize>,
    /// The grid of noise levels, if it is not the denoiser's.
    #[serde(default)]
    pub grid: StepGrid,
}

/// A method of sampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum SamplerKind {
    /// Second order, two evaluations per step but for the last; the paper's.
    #[serde(rename = "heun")]
    Heun,
    /// First order, one evaluation per step.
    #[serde(rename = "euler")]
    Euler,
    /// Second order, one evaluation per step (DPM-Solver++ 2M).
    #[serde(rename = "dpmpp_2m")]
    Dpmpp2m,
}

named! { SamplerKind { Heun = "heun", Euler = "euler", Dpmpp2m = "dpmpp_2m" } }

impl Default for SamplerConfig {
    fn default() -> Self {
        Self::heun(50)
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
    const fn of(kind: SamplerKind, n_steps: usize) -> Self {
        Self { kind, n_steps: Some(n_steps), grid: StepGrid { sigma_max: None, sigma_min: None } }
    }

    /// Heun's sampler with this many steps.
    pub const fn heun(n_steps: usize) -> Self {
        Self::of(SamplerKind::Heun, n_steps)
    }

    /// Euler's sampler with this many steps.
    pub const fn euler(n_steps: usize) -> Self {
        Self::of(SamplerKind::Euler, n_steps)
    }

    /// DPM-Solver++ (2M) with this many steps.
    pub const fn dpmpp_2m(n_steps: usize) -> Self {
        Self::of(SamplerKind::Dpmpp2m, n_steps)
    }

    /// This sampler on another grid.
    #[must_use]
    pub const fn on(self, grid: StepGrid) -> Self {
        Self { grid, ..self }
    }

    /// The sampler with its number of steps filled in.
    #[must_use]
    pub const fn resolved(self) -> Self {
        Self { n_steps: Some(self.n_steps()), ..self }
    }

    /// Number of steps N.
    pub const fn n_steps(&self) -> usize {
        match (self.n_steps, self.kind) {
            (Some(n_steps), _) => n_steps,
            (None, SamplerKind::Heun) => 50,
            (None, SamplerKind::Euler) => 100,
            (None, SamplerKind::Dpmpp2m) => 40,
        }
    }

    /// Number of evaluations of the denoiser for one sample. Heun's last step, to σ = 0, needs only one.
    pub const fn n_evaluations(&self) -> usize {
        match self.kind {
            SamplerKind::Heun => (2 * self.n_steps()).saturating_sub(1),
            SamplerKind::Euler | SamplerKind::Dpmpp2m => self.n_steps(),
        }
    }

    /// Checks the settings.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        self.grid.validate().map_err(|issue| issue.within("grid"))
    }

    /// The noise level that sampling begins with.
    pub fn sigma_start(&self, edm: &Edm) -> f64 {
        self.grid.laid_over(edm).sigma_max
    }

    /// The noise levels of its steps from `sigma_start`, the last of them 0.
    pub fn schedule(&self, edm: &Edm, sigma_start: f64) -> Vec<f64> {
        let edm = self.grid.laid_over(edm);
        // An edit may begin at or below the last level of the grid: there is one step then, to 0.
        match sigma_start <= edm.sigma_min {
            true => vec![sigma_start, 0.0],
            false => edm.schedule_from(sigma_start, self.n_steps()),
        }
    }

    /// The name for provenance: the kind, the number of steps and, if it is not the default, the grid: such as
    /// `heun-50`.
    pub fn name(&self) -> String {
        format!("{}-{}{}", self.kind.name(), self.n_steps(), self.grid.suffix())
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
        self.integrate(&self.schedule(edm, sigma_start), denoiser, x, observer)
    }

    /// Integrates from `x` (B, …), a state at noise level `sigmas[0]`, along the decreasing `sigmas` to the last of
    /// them, in one step between each two.
    pub fn integrate(
        &self,
        sigmas: &[f64],
        denoiser: &dyn Denoiser,
        x: Tensor,
        observer: &mut Observer<'_>,
    ) -> Result<Tensor> {
        match self.kind {
            SamplerKind::Heun => heun::integrate(sigmas, denoiser, x, observer),
            SamplerKind::Euler => euler::integrate(sigmas, denoiser, x, observer),
            SamplerKind::Dpmpp2m => dpmpp_2m::integrate(sigmas, denoiser, x, observer),
        }
    }
}

/// D(x; σ) with the same noise level in every row, detached from the graph of a trainable network: over many steps that
/// graph would keep the activations of every evaluation alive.
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
