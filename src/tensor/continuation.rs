//! The expected continuation of an agent: a linear prediction from its observed motion.
//!
//! The reference of an agent continues its velocity. Its acceleration and curvature show in its observed steps p beyond
//! that velocity, and W p with W = C_zp C_pp⁻¹ is the best linear prediction of its future motion z beyond it (Wiener's
//! filter). The rest z - W p is diffused: a sample of zeros continues the agent's observed motion, and the covariance
//! of the rest tells how quickly traffic departs from it.

use super::MotionCovariance;
use super::eigen::symmetric_eigen;
use std::sync::{Arc, OnceLock};

/// Variances below this share of the largest are rounding errors.
const MIN_RELATIVE_VARIANCE: f64 = 1e-12;
/// So are those below this share of the variance of errors of positions. Steps cannot vary so little: the continued
/// velocity follows from them. In a recording whose velocity has another origin, such directions mean nothing.
pub(super) const MIN_SHARE_OF_NOISE: f64 = 0.01;

/// The prediction from the last k observed steps.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Continuation {
    /// W for each diffused dimension: N x k, row by row, the steps in order of time.
    weights: Vec<Vec<f64>>,
    /// Covariance of z - W p for each diffused dimension: N x N, row by row.
    pub(super) covariance: Vec<Vec<f64>>,
}

impl Continuation {
    /// z - W p in dimension `dim`, for the k observed steps `past` and the motion z after them.
    pub(super) fn beyond(&self, dim: usize, past: &[f64], future: &[f64]) -> Vec<f64> {
        let predicted = product(&self.weights[dim], past, past.len(), 1);
        future.iter().zip(predicted).map(|(z, predicted)| z - predicted).collect()
    }

    /// The sums of the predicted motion W p over 1, 2, … N timesteps, for the k observed steps `past` by ascending
    /// time. Dimensions that are not diffused continue like the reference.
    pub(super) fn sums(&self, past: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let n = self.weights.first().map_or(0, |weights| weights.len() / past.len().max(1));
        let mut sum = [0.0; 3];
        let at = |i: usize| {
            for (dim, weights) in self.weights.iter().enumerate() {
                let row = &weights[i * past.len()..(i + 1) * past.len()];
                sum[dim] += row.iter().zip(past).map(|(weight, step)| weight * step[dim]).sum::<f64>();
            }
            sum
        };
        (0..n).map(at).collect()
    }
}

/// The continuations of a covariance by their number of observed steps, made when they are first needed.
#[derive(Debug, Clone, Default)]
pub(super) struct Continuations(Arc<OnceLock<Vec<Continuation>>>);

impl PartialEq for Continuations {
    /// They follow from the covariance.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl MotionCovariance {
    /// The continuation of an agent whose last `n_past` steps were observed, at most as many as the covariance covers.
    pub(super) fn continuation(&self, n_past: usize) -> Option<&Continuation> {
        let all = || (1..=self.n_past).map(|n_past| self.predict(n_past)).collect();
        self.continuations.0.get_or_init(all).get(n_past.checked_sub(1)?)
    }

    fn predict(&self, n_past: usize) -> Continuation {
        let n = self.n_timesteps;
        let (mut weights, mut covariance) = (Vec::new(), Vec::new());
        for dim in 0..self.values.len() {
            let noise = self.noise_covariance(dim);
            let least = MIN_SHARE_OF_NOISE * self.noise.get(dim).map_or(0.0, |noise| noise * noise);
            let size = self.n_past + n;
            let past = |i: usize| self.n_past - n_past + i;
            let future = |i: usize| self.n_past + i;
            let c = |i: usize, j: usize| self.values[dim][i * size + j];
            let noisy = |i: usize, j: usize| c(i, j) + noise[i * size + j];
            let of_past = grid(n_past, n_past, |i, j| noisy(past(i), past(j)));
            let (inverse, _) = inverse(of_past, n_past, least);
            let to_past = grid(n, n_past, |i, j| noisy(future(i), past(j)));
            let w = product(&to_past, &inverse, n_past, n_past);
            // The covariance of z - W p in the recordings: C_zz - W C_pz - C_zp Wᵀ + W C_pp Wᵀ.
            let explained =
                |i: usize, j: usize| (0..n_past).map(|k| w[i * n_past + k] * c(past(k), future(j))).sum::<f64>();
            let spread = product(&w, &grid(n_past, n_past, |i, j| c(past(i), past(j))), n_past, n_past);
            let of_prediction =
                |i: usize, j: usize| (0..n_past).map(|k| spread[i * n_past + k] * w[j * n_past + k]).sum::<f64>();
            covariance.push(grid(n, n, |i, j| {
                c(future(i), future(j)) - explained(i, j) - explained(j, i) + of_prediction(i, j)
            }));
            weights.push(w);
        }
        Continuation { weights, covariance }
    }

    /// The covariance of steps and future motion that independent errors of the observed positions (or headings) cause,
    /// in the order of `values`.
    fn noise_covariance(&self, dim: usize) -> Vec<f64> {
        let size = self.n_past + self.n_timesteps;
        let entry = |i: usize, position: usize| self.share_of_error(dim, i, position);
        let variance = self.noise.get(dim).map_or(0.0, |noise| noise * noise);
        grid(size, size, |i, j| {
            variance * (0..=self.n_past).map(|position| entry(i, position) * entry(j, position)).sum::<f64>()
        })
    }

    /// The weight of the error of observed position (or heading) 0 to K in entry `i` of `values`: each step is a
    /// difference of two positions, and the continued velocity is the slope of the parabola through the last three.
    pub(super) fn share_of_error(&self, dim: usize, i: usize, position: usize) -> f64 {
        let k = self.n_past;
        let of_velocity = match (dim < 2, k - position) {
            (true, 0) if k > 1 => 1.5,
            (true, 1) if k > 1 => -2.0,
            (true, 2) => 0.5,
            (true, 0) => 1.0,
            (true, 1) => -1.0,
            _ => 0.0,
        };
        let of_step = match i {
            i if i < k => f64::from(u8::from(position == i + 1)) - f64::from(u8::from(position == i)),
            i if i == k => -f64::from(u8::from(position == k)),
            _ => 0.0,
        };
        of_step - of_velocity
    }
}

pub(super) fn grid(n_rows: usize, n_columns: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    (0..n_rows * n_columns).map(|at| value(at / n_columns, at % n_columns)).collect()
}

/// A B for A (… x `inner`) and B (`inner` x `n_columns`), row by row.
pub(super) fn product(a: &[f64], b: &[f64], inner: usize, n_columns: usize) -> Vec<f64> {
    grid(a.len() / inner, n_columns, |i, j| (0..inner).map(|k| a[i * inner + k] * b[k * n_columns + j]).sum())
}

/// The inverse of the symmetric `n` x `n` matrix `a` and the logarithm of its determinant; directions with rounding
/// errors alone, or a variance below `min_variance`, are left out of both.
pub(super) fn inverse(a: Vec<f64>, n: usize, min_variance: f64) -> (Vec<f64>, f64) {
    let eigen = symmetric_eigen(a, n);
    let largest = eigen.values.iter().copied().fold(0.0, f64::max);
    let least = (MIN_RELATIVE_VARIANCE * largest).max(min_variance);
    let inverted = |value: f64| if value > least { value.recip() } else { 0.0 };
    let factors: Vec<f64> = eigen.values.iter().map(|value| inverted(*value)).collect();
    let log_determinant = eigen.values.iter().filter(|value| **value > least).map(|value| value.ln()).sum();
    let vector = |k: usize, i: usize| eigen.vectors[k * n + i];
    (grid(n, n, |i, j| (0..n).map(|k| factors[k] * vector(k, i) * vector(k, j)).sum()), log_determinant)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Motion that changes by decimeters a timestep within a second or so, seen to 1 mm.
    pub(in crate::tensor) fn wandering(k: usize, n: usize) -> MotionCovariance {
        let size = k + n;
        let smooth = |i: usize, j: usize| 0.01 * (-0.5 * (i.abs_diff(j) as f64 / 8.0).powi(2)).exp();
        // Beyond the velocity at the present, the slope of the parabola through the last three positions.
        let entry = |i: usize, m: usize| {
            let velocity = if m + 1 == k { 1.5 } else { 0.0 } - if m + 2 == k { 0.5 } else { 0.0 };
            f64::from(u8::from(i == m)) - velocity
        };
        let half = product(&grid(size, size, entry), &grid(size, size, smooth), size, size);
        let values = product(&half, &grid(size, size, |i, j| entry(j, i)), size, size);
        MotionCovariance::new(k, n, vec![values], vec![0.001])
    }

    /// Motion at constant acceleration a of unit variance along the first dimension, beyond the velocity at the
    /// present: the steps before it are a (i - 1/2 - k) for i = 1 to k, those after it a (i - 1/2).
    fn accelerating(n_past: usize, n_timesteps: usize, noise: f64) -> MotionCovariance {
        let step = |i: usize| i as f64 + 0.5 - n_past as f64;
        let size = n_past + n_timesteps;
        MotionCovariance::new(n_past, n_timesteps, vec![grid(size, size, |i, j| step(i) * step(j))], vec![noise])
    }

    #[test]
    fn acceleration_goes_on() {
        let covariance = accelerating(4, 6, 0.0);
        for n_past in 1..=4 {
            let continuation = covariance.continuation(n_past).unwrap();
            let past: Vec<[f64; 3]> = (0..n_past).map(|i| [2.0 * (i as f64 + 0.5 - n_past as f64), 9.0, 9.0]).collect();
            // Sums of 2 (i - 1/2) are i².
            for (i, sum) in (1..).zip(continuation.sums(&past)) {
                assert!((sum[0] - f64::from(i * i)).abs() < 1e-9 && sum[1..] == [0.0, 0.0], "{n_past} {i}: {sum:?}");
            }
            assert!(continuation.covariance[0].iter().all(|c| c.abs() < 1e-9), "nothing is left to chance");
        }
        assert!(covariance.continuation(0).is_none() && covariance.continuation(5).is_none());
    }

    #[test]
    fn noise_makes_the_prediction_careful() {
        // With one observed step p of -a / 2 and a step after it of z = a / 2, with errors e0, e1 of the two positions:
        // the continued velocity errs by e1 - e0, the step by nothing beyond it, and z by -e1 - (e1 - e0).
        let covariance = accelerating(1, 1, 0.3);
        let noise = covariance.noise_covariance(0);
        for (found, expected) in noise.iter().zip([0.0, 0.0, 0.0, 0.09 * 5.0]) {
            assert!((found - expected).abs() < 1e-12, "{noise:?}");
        }
        // Three positions: p = (e1 - e0 - v, e2 - e1 - v), z = (-e2 - v, -v) with v = 1.5 e2 - 2 e1 + 0.5 e0.
        let noise = accelerating(2, 2, 1.0).noise_covariance(0);
        let rows = [[-1.5, 3.0, -1.5], [-0.5, 1.0, -0.5], [-0.5, 2.0, -2.5], [-0.5, 2.0, -1.5]];
        for (i, a) in rows.iter().enumerate() {
            for (j, b) in rows.iter().enumerate() {
                let expected: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
                assert!((noise[i * 4 + j] - expected).abs() < 1e-12, "{i} {j}");
            }
        }
        // Large errors leave nothing of the prediction; the unpredicted part is then left to chance.
        let careful = accelerating(4, 2, 100.0);
        let continuation = careful.continuation(4).unwrap();
        assert!(continuation.covariance[0][0] > 0.2, "{:?}", continuation.covariance);
    }

    #[test]
    fn a_velocity_that_does_not_follow_from_the_positions_moves_nobody() {
        // Off by 1 mm a timestep, which no errors of positions explain.
        let covariance = wandering(9, 30);
        let moved = covariance.continuation(9).unwrap().sums(&[[0.001, 0.0, 0.0]; 9])[29][0];
        assert!(moved.abs() < 0.3, "{moved}");
    }

    #[test]
    fn the_rest_does_not_correlate_with_the_past() {
        // A covariance that is not special: A Aᵀ.
        let (k, n) = (3, 4);
        let a = grid(k + n, k + n, |i, j| ((i * 7 + j * 3) as f64 * 0.7).sin());
        let values = grid(k + n, k + n, |i, j| (0..k + n).map(|l| a[i * 7 + l] * a[j * 7 + l]).sum());
        let covariance = MotionCovariance::new(k, n, vec![values.clone()], vec![0.0]);
        let continuation = covariance.continuation(k).unwrap();
        let c = |i: usize, j: usize| values[i * (k + n) + j];
        for (i, j) in (0..n).flat_map(|i| (0..k).map(move |j| (i, j))) {
            let w = |l: usize| continuation.weights[0][i * k + l];
            let rest = c(k + i, j) - (0..k).map(|l| w(l) * c(l, j)).sum::<f64>();
            assert!(rest.abs() < 1e-6, "{i} {j}: {rest}");
        }
    }
}
