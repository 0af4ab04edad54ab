//! Groups of samples of which those that promise most go on: sequential Monte Carlo over noise levels.

use super::CleanPotential;
use crate::diffusion::{sampler::Going, sigma_rows};
use crate::seed::Seed;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the samples of a group, the particles, are resampled on the way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ParticleConfig {
    /// Number of particles of a group. All of them become samples; `n_samples` is a multiple of it.
    #[schemars(range(min = 2, max = 1000))]
    pub n: usize,
    /// How strongly particles are weighted by the sweep's objectives J: by exp(strength · J).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub strength: f64,
    /// A group is resampled where the effective number of its particles, (Σ w)² / Σ w², falls below this share of them.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub resample_below: f64,
}

impl Default for ParticleConfig {
    fn default() -> Self {
        Self { n: 4, strength: 1.0, resample_below: 0.5 }
    }
}

/// Groups of particles on their way from noise to samples.
///
/// A group stands for the distribution p(x₀) exp(s J(x₀)), where p is the one that its sampler draws from, guided or not
/// (a Feynman-Kac model; Wu et al. 2023, Singhal et al. 2025). At each noise level a particle has the weight
/// exp(s (J(x̂₀) - J(x̂₀'))), where x̂₀ is its clean estimate and x̂₀' the one of its ancestor when the group was last
/// resampled. Along a path these weights multiply to exp(s J(x₀)) whatever the estimates in between, which only decide
/// how early particles are told apart. With n particles the error is of order 1/n.
///
/// Weights that are left at the end are not applied: copies that no noise can part would be identical. They are nearly
/// equal if `resample_below` is near 1.
pub struct Particles<'a> {
    config: &'a ParticleConfig,
    potential: &'a dyn CleanPotential,
    /// One for each group; its particles are neighboring rows.
    seeds: Vec<Seed>,
    /// s J of each particle's ancestor when its group was last resampled; 0 before.
    before: Vec<f64>,
    /// s J of each particle's last estimate.
    now: Vec<f64>,
    n_steps: u64,
}

impl<'a> Particles<'a> {
    /// One group of particles for each of the seeds.
    pub fn new(config: &'a ParticleConfig, potential: &'a dyn CleanPotential, seeds: Vec<Seed>) -> Self {
        let n_rows = seeds.len() * config.n;
        Self { config, potential, seeds, before: vec![0.0; n_rows], now: vec![0.0; n_rows], n_steps: 0 }
    }

    /// Weighs the particles by their estimates; the rows that go on if a group is resampled
    /// ([`crate::diffusion::sampler::Resampler`]).
    ///
    /// # Errors
    /// When the number of rows is not that of the particles.
    pub fn step(&mut self, going: &Going<'_>) -> Result<Option<Tensor>> {
        let found = sigma_rows(&self.potential.log_potential(&going.x0_hat.detach())?)?;
        if found.len() != self.now.len() {
            candle_core::bail!("{} particles were announced for a batch of {} rows", self.now.len(), found.len());
        }
        // An estimate that is not finite is worth nothing.
        let worth = |j: f64| if j.is_finite() { self.config.strength * j } else { f64::NEG_INFINITY };
        self.now = found.into_iter().map(worth).collect();
        self.n_steps += 1;
        if !going.adds_noise {
            return Ok(None);
        }
        let rows: Vec<usize> = (0..self.seeds.len()).flat_map(|group| self.rows(group)).collect();
        if rows.iter().enumerate().all(|(at, row)| at == *row) {
            return Ok(None);
        }
        let rows: Vec<u32> = rows.into_iter().map(|row| row as u32).collect();
        let n_rows = rows.len();
        Tensor::from_vec(rows, n_rows, going.x0_hat.device()).map(Some)
    }

    /// The weights of a group's particles, which add up to 1: equal ones where none is worth anything.
    pub fn weights(&self, group: usize) -> Vec<f64> {
        let n = self.config.n;
        let own = group * n..(group + 1) * n;
        let logs: Vec<f64> = own.map(|row| self.now[row] - self.before[row]).collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !most.is_finite() {
            return vec![1.0 / n as f64; n];
        }
        let weights: Vec<f64> =
            logs.iter().map(|log| (log - most).exp()).map(|w| if w > 0.0 { w } else { 0.0 }).collect();
        let total: f64 = weights.iter().sum();
        weights.into_iter().map(|weight| weight / total).collect()
    }

    /// For each row of a group the row that goes on in its place; resampling settles the weights.
    fn rows(&mut self, group: usize) -> Vec<usize> {
        let n = self.config.n;
        let first = group * n;
        let weights = self.weights(group);
        let n_effective = 1.0 / weights.iter().map(|weight| weight * weight).sum::<f64>();
        if n_effective >= self.config.resample_below * n as f64 {
            return (first..first + n).collect();
        }
        let at = self.seeds[group].derive("resampling", &[self.n_steps]).rng().uniform();
        let rows: Vec<usize> = in_place(&systematic(&weights, at)).into_iter().map(|row| first + row).collect();
        for (at, row) in rows.iter().enumerate() {
            self.before[first + at] = self.now[*row];
        }
        self.now[first..first + n].copy_from_slice(&self.before[first..first + n]);
        rows
    }
}

/// How often each of n particles goes on, n in all, with the weights (which add up to 1) as expected shares: systematic
/// resampling, with `at` uniform in [0, 1). A particle goes on ⌊n w⌋ or ⌈n w⌉ times.
fn systematic(weights: &[f64], at: f64) -> Vec<usize> {
    let n = weights.len();
    let mut before = 0.0;
    let mut n_before = 0;
    let mut counts = Vec::with_capacity(n);
    for (i, weight) in weights.iter().enumerate() {
        before += weight * n as f64;
        // The number of points at, at + 1, … below the cumulative weight; all of them at the end, whatever the rounding.
        let n_below = if i + 1 == n { n } else { ((before - at).ceil().max(0.0) as usize).min(n) };
        counts.push(n_below - n_before);
        n_before = n_below;
    }
    counts
}

/// Particles that go on stay where they are, and further copies of them take the places of those that do not.
fn in_place(counts: &[usize]) -> Vec<usize> {
    let mut copies =
        counts.iter().enumerate().flat_map(|(row, count)| std::iter::repeat_n(row, count.saturating_sub(1)));
    let places = counts.iter().enumerate();
    places.map(|(row, count)| if *count > 0 { row } else { copies.next().unwrap_or(row) }).collect()
}

#[cfg(test)]
#[path = "particles_tests.rs"]
mod tests;
