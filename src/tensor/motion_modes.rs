//! The covariance of diffused motion along time, and its independent modes.
//!
//! The motion of traffic is smooth: the numbers that the motion parametrization diffuses are nearly equal from timestep
//! to timestep. A denoiser that knows their covariance C = Uᵀ Λ U averages white noise away before a network sees it.

use super::continuation::Continuations;
use super::eigen::{Eigen, symmetric_eigen};
use super::motion::MotionChain;
use super::normalizer::Normalizer;
use super::observation_errors::Estimates;
use super::texture::{ModesOfPast, Texture, is_fast};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// The least variance of a mode if the noise of recordings is unknown.
const MIN_VARIANCE: f64 = 1e-4;
/// The least standard deviation of a mode as a share of the noise of observed positions.
const MIN_SHARE_OF_NOISE: f64 = 0.2;

/// Covariance of an agent's motion along time in training traffic, in units of x: of K observed steps beyond the
/// velocity at the present, and of the motion z at N timesteps after it, when nothing later is observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionCovariance {
    /// Number of observed steps K.
    #[serde(default)]
    pub n_past: usize,
    /// Number of timesteps N.
    pub n_timesteps: usize,
    /// One (K + N) x (K + N) matrix for each diffused dimension, row by row, in order of time.
    pub values: Vec<Vec<f64>>,
    /// The standard deviation of errors of observed positions and headings for which predictions from them allow, one
    /// per dimension; empty without K.
    #[serde(default)]
    pub noise: Vec<f64>,
    /// The relation of rough motion to rough steps, one per dimension; empty if unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub texture: Vec<Texture>,
    #[serde(skip)]
    pub(super) modes_of_past: ModesOfPast,
    #[serde(skip)]
    pub(super) continuations: Continuations,
    #[serde(skip)]
    pub(super) estimates: Estimates,
}

impl MotionCovariance {
    /// A covariance of `n_past` observed steps and `n_timesteps` future ones.
    pub(super) fn new(n_past: usize, n_timesteps: usize, values: Vec<Vec<f64>>, noise: Vec<f64>) -> Self {
        let (texture, modes_of_past, continuations, estimates) = Default::default();
        Self { n_past, n_timesteps, values, noise, texture, modes_of_past, continuations, estimates }
    }

    /// This covariance with the texture of each dimension, as far as known.
    pub(super) fn with_texture(self, texture: Vec<Option<Texture>>) -> Self {
        if texture.iter().all(Option::is_none) {
            return self;
        }
        let texture = texture.into_iter().map(|known| known.unwrap_or(Texture::AVERAGE)).collect();
        Self { texture, ..self }
    }

    /// The least variance of a mode: half a millimeter of noise a step gives a sample away, and no recording is
    /// smoother than it is exact.
    fn min_variance(&self, dim: usize) -> f64 {
        self.noise.get(dim).map_or(MIN_VARIANCE, |noise| (MIN_SHARE_OF_NOISE * noise).powi(2))
    }

    /// Covariance of the residual r (the sum of z, or of z - W p after `n_past` observed steps) at `i` and `j`
    /// timesteps after the last observed one, counted from 1. Beyond N timesteps, motion continues as in the last of
    /// them.
    fn sums(&self, dim: usize, n: usize, n_past: usize) -> Vec<f64> {
        let at = |i: usize| i.min(self.n_timesteps.saturating_sub(1));
        let continued = self.continuation(n_past).map(|continuation| &continuation.covariance[dim]);
        let size = self.n_past + self.n_timesteps;
        let z = |i: usize, j: usize| match continued {
            Some(rest) => rest[at(i) * self.n_timesteps + at(j)],
            None => self.values[dim][(self.n_past + at(i)) * size + self.n_past + at(j)],
        };
        let mut sums = vec![0.0; n * n];
        for i in 0..n {
            let mut row = 0.0;
            for j in 0..n {
                row += z(i, j);
                sums[i * n + j] = row + if i > 0 { sums[(i - 1) * n + j] } else { 0.0 };
            }
        }
        sums
    }
}

/// Modes of one agent's motion: for each diffused dimension an orthonormal basis of the latent timesteps and the
/// variance along each of its vectors.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MotionModes {
    /// (D, T, T), one mode per row; zero at timesteps that are not latent, and in rows without a mode.
    pub(super) vectors: Vec<f32>,
    /// (D, T); zero in rows without a mode.
    pub(super) variances: Vec<f32>,
}

impl MotionModes {
    /// Removes the modes of the dimensions from `dim` on, in which nothing is generated.
    pub(super) fn clear_from(&mut self, dim: usize, n_timesteps: usize) {
        if let Some(vectors) = self.vectors.get_mut(dim * n_timesteps * n_timesteps..) {
            vectors.fill(0.0);
        }
        if let Some(variances) = self.variances.get_mut(dim * n_timesteps..) {
            variances.fill(0.0);
        }
    }
}

/// A stretch of latent timesteps without an observed one in between.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Stretch {
    /// Timesteps from the observed state that the stretch is counted from, ascending, from 1.
    offsets: Vec<usize>,
    /// Timesteps between the observed states at its two ends; `None` if only one end has one.
    gap: Option<usize>,
    /// Number of observed steps from which its motion is predicted.
    n_past: usize,
}

/// Computes modes, and caches those of stretches.
#[derive(Debug, Default)]
pub(super) struct ModeTable {
    known: Mutex<HashMap<Stretch, Arc<Vec<Eigen>>>>,
}

impl ModeTable {
    /// The modes of an agent that is observed at `observed` and generated at `latent` timesteps, both ascending, of
    /// `n_timesteps`. After the last observed one its motion is predicted from `n_past` steps, and the variances of
    /// fast motion are `texture` times the average ones, a dimension each. An agent that is never observed has the
    /// variance σ_data² everywhere.
    pub(super) fn modes(
        &self,
        covariance: &MotionCovariance,
        (observed, n_past, texture): (&[usize], usize, [f64; 3]),
        latent: &[usize],
        n_timesteps: usize,
    ) -> MotionModes {
        let n_dims = covariance.values.len();
        let size = n_timesteps * n_timesteps;
        let mut modes = MotionModes { vectors: vec![0.0; n_dims * size], variances: vec![0.0; n_dims * n_timesteps] };
        if observed.is_empty() {
            for (dim, t) in (0..n_dims).flat_map(|dim| latent.iter().map(move |t| (dim, *t))) {
                modes.vectors[dim * size + t * n_timesteps + t] = 1.0;
                modes.variances[dim * n_timesteps + t] = Normalizer::SIGMA_DATA.powi(2) as f32;
            }
            return modes;
        }
        for (timesteps, stretch) in stretches(observed, n_past, latent) {
            let texture = if stretch.n_past > 0 { texture } else { [1.0; 3] };
            let eigen = self.of_stretch(covariance, stretch);
            for (dim, Eigen { values, vectors }) in eigen.iter().enumerate() {
                let n_larger = |value: f64| values.iter().filter(|other| **other > value).count();
                for ((slot, value), vector) in timesteps.iter().zip(values).zip(vectors.chunks(timesteps.len())) {
                    let factor = if is_fast(n_larger(*value), values.len()) { texture[dim] } else { 1.0 };
                    let variance = (value * factor).max(covariance.min_variance(dim));
                    modes.variances[dim * n_timesteps + slot] = variance as f32;
                    for (t, component) in timesteps.iter().zip(vector) {
                        modes.vectors[dim * size + slot * n_timesteps + t] = *component as f32;
                    }
                }
            }
        }
        modes
    }

    fn of_stretch(&self, covariance: &MotionCovariance, stretch: Stretch) -> Arc<Vec<Eigen>> {
        let known = |table: &Mutex<HashMap<Stretch, Arc<Vec<Eigen>>>>| {
            table.lock().unwrap_or_else(PoisonError::into_inner).get(&stretch).cloned()
        };
        if let Some(eigen) = known(&self.known) {
            return eigen;
        }
        let eigen = Arc::new(
            (0..covariance.values.len())
                .map(|dim| symmetric_eigen(stretch.covariance(covariance, dim), stretch.offsets.len()))
                .collect::<Vec<_>>(),
        );
        // Random masks rarely repeat long stretches, so the cache is bounded.
        let mut table = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if table.len() < 4096 {
            table.insert(stretch, eigen.clone());
        }
        eigen
    }
}

impl Stretch {
    /// Covariance of the motion z of this stretch, row by row: that of free motion, conditioned on its end if that is
    /// observed.
    fn covariance(&self, covariance: &MotionCovariance, dim: usize) -> Vec<f64> {
        let last = self.offsets.last().copied().unwrap_or(0);
        let n = self.gap.unwrap_or(last).max(last);
        let sums = covariance.sums(dim, n, self.n_past);
        let free = |i: usize, j: usize| sums[(i - 1) * n + j - 1];
        let residual = |i: usize, j: usize| match self.gap {
            Some(gap) => free(i, j) - free(i, gap) * free(gap, j) / free(gap, gap).max(MIN_VARIANCE),
            None => free(i, j),
        };
        let observed: Vec<usize> = [0].into_iter().chain(self.gap).collect();
        MotionChain::new(&observed, &self.offsets).covariance(residual)
    }
}

/// The latent timesteps between observed ones, each stretch in the order in which it is counted from an observed state.
fn stretches(observed: &[usize], n_past: usize, latent: &[usize]) -> Vec<(Vec<usize>, Stretch)> {
    let mut found: Vec<(Vec<usize>, Stretch)> = Vec::new();
    let mut rest = latent;
    while let Some(first) = rest.first() {
        let next = observed.partition_point(|t| t < first);
        let n = observed.get(next).map_or(rest.len(), |after| rest.partition_point(|t| t < after));
        let (these, others) = rest.split_at(n);
        rest = others;
        let stretch = match (next.checked_sub(1).map(|i| observed[i]), observed.get(next)) {
            (Some(before), after) => {
                let offsets = these.iter().map(|t| t - before).collect();
                let n_past = if after.is_none() { n_past } else { 0 };
                (these.to_vec(), Stretch { offsets, gap: after.map(|after| after - before), n_past })
            }
            (None, Some(after)) => {
                let backward: Vec<usize> = these.iter().rev().copied().collect();
                let offsets = backward.iter().map(|t| after - t).collect();
                (backward, Stretch { offsets, gap: None, n_past: 0 })
            }
            (None, None) => continue,
        };
        found.push(stretch);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White motion: z independent, with variance 2.
    fn white(n: usize) -> MotionCovariance {
        let values = (0..n * n).map(|k| if k / n == k % n { 2.0 } else { 0.0 }).collect();
        MotionCovariance::new(0, n, vec![values], Vec::new())
    }

    #[test]
    fn white_motion_stays_white_in_every_stretch() {
        // A Brownian path given its end is the bridge that the chain is made of: its motion is white again.
        let table = ModeTable::default();
        let modes = table.modes(&white(6), (&[3, 8], 0, [1.0; 3]), &[0, 1, 2, 4, 5, 7, 9, 11], 12);
        for t in 0..12 {
            let expected = if [3, 6, 8, 10].contains(&t) { 0.0 } else { 2.0 };
            assert!((modes.variances[t] - expected).abs() < 1e-5, "{t}: {:?}", modes.variances);
            let norm: f32 = modes.vectors[t * 12..(t + 1) * 12].iter().map(|v| v * v).sum();
            assert!((norm - if expected > 0.0 { 1.0 } else { 0.0 }).abs() < 1e-5);
        }
    }

    #[test]
    fn modes_diagonalize_the_covariance_of_free_motion() {
        // Constant acceleration: z_t = a t, so that one mode holds all the variance.
        let n = 5;
        let values = (0..n * n).map(|k| ((k / n + 1) * (k % n + 1)) as f64).collect();
        let covariance = MotionCovariance::new(0, n, vec![values], Vec::new());
        let modes = ModeTable::default().modes(&covariance, (&[0], 0, [1.0; 3]), &[1, 2, 3, 4, 5], 6);
        let total: f32 = modes.variances.iter().sum();
        let largest = modes.variances.iter().copied().fold(0.0, f32::max);
        assert!((total - 55.0).abs() < 1e-3 && (largest - 55.0).abs() < 1e-3, "{:?}", modes.variances);
    }

    #[test]
    fn who_is_never_observed_is_white() {
        let modes = ModeTable::default().modes(&white(3), (&[], 0, [1.0; 3]), &[1, 3], 4);
        assert_eq!(modes.variances, [0.0, 0.25, 0.0, 0.25]);
    }

    #[test]
    fn a_predicted_stretch_has_the_modes_of_the_rest() {
        // z1 = p + e with e of variance 0.5, z2 = e2 of variance 3; p of variance 2 is observed without noise.
        let values = vec![2.0, 2.0, 0.0, 2.0, 2.5, 0.0, 0.0, 0.0, 3.0];
        let covariance = MotionCovariance::new(1, 2, vec![values], vec![0.0]);
        let variances = |n_past: usize, latent: &[usize]| {
            let mut found = ModeTable::default().modes(&covariance, (&[0, 1], n_past, [1.0; 3]), latent, 4).variances;
            found.sort_by(f32::total_cmp);
            found
        };
        assert!(variances(1, &[2, 3]).iter().zip([0.0, 0.0, 0.5, 3.0]).all(|(a, b)| (a - b).abs() < 1e-5));
        assert!(variances(0, &[2, 3]).iter().zip([0.0, 0.0, 2.5, 3.0]).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
