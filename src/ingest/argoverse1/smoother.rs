//! Estimates motion from Argoverse 1's positions, which come unfiltered and at uneven times from a tracker.
//!
//! A Rauch-Tung-Striebel smoother (Särkkä, "Bayesian Filtering and Smoothing", 2013, algorithms 4.2 and 8.2), for each
//! axis alone: the acceleration is white noise, and recorded positions have white Gaussian noise with a standard
//! deviation for each track. The recorder is known to centimeters, agents far from it to half a meter.
//! `scripts/check_track_smoother.py` explains how the constants were found, and checks this file.

use crate::geometry::Vec2;

/// Spectral density of the acceleration, m²/s³: velocities change by about half a meter per second within a second.
/// Among 0.3, 1, 3 and 10, this maximizes the likelihood of all tracks of the train split.
const ACCELERATION_DENSITY_M2PS3: f64 = 0.3;

/// The possible standard deviations of a track's recorded positions, meters.
const NOISE_M: [f64; 8] = [0.02, 0.035, 0.06, 0.1, 0.17, 0.3, 0.5, 0.85];

/// The prior of a track's noise: log-normal with this median, meters, and this standard deviation of the logarithm.
const NOISE_MEDIAN_M: f64 = 0.15;
const NOISE_LOG_STD: f64 = 0.9;

/// The prior of a track's state: standard deviations of its distance from the first position, meters, and of its
/// velocity, m/s.
const START_STD_M: f64 = 10.0;
const START_STD_MPS: f64 = 10.0;

/// A time at which a track is recorded, or its state is estimated, or both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    /// Seconds.
    pub(super) time_s: f64,
    pub(super) recorded: Option<Vec2>,
}

/// The estimate of a track's state at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Estimate {
    /// Mean of the position, meters.
    pub(super) position: Vec2,
    /// Mean of the velocity, m/s.
    pub(super) velocity: Vec2,
    /// For each axis: variance of the position, covariance, variance of the velocity.
    covariance: [f64; 3],
}

impl Estimate {
    /// The prior at the first position.
    fn at_start(position: Vec2) -> Self {
        let covariance = [START_STD_M * START_STD_M, 0.0, START_STD_MPS * START_STD_MPS];
        Self { position, velocity: Vec2::ZERO, covariance }
    }

    /// The estimate without uncertainty, so that later states continue exactly from here.
    pub(super) fn for_certain(self) -> Self {
        Self { covariance: [0.0; 3], ..self }
    }

    fn predicted(&self, h_s: f64) -> Self {
        let [pp, pv, vv] = self.covariance;
        let q = ACCELERATION_DENSITY_M2PS3;
        let covariance = [
            pp + 2.0 * h_s * pv + h_s * h_s * vv + q * h_s.powi(3) / 3.0,
            pv + h_s * vv + q * h_s * h_s / 2.0,
            vv + q * h_s,
        ];
        Self { position: self.position + self.velocity * h_s, velocity: self.velocity, covariance }
    }

    /// The estimate after a recorded position, and the position's log-likelihood in nats.
    fn updated(&self, recorded: Vec2, noise_m: f64) -> (Self, f64) {
        let [pp, pv, vv] = self.covariance;
        let variance = pp + noise_m * noise_m;
        let offset = recorded - self.position;
        let (gain_p, gain_v) = (pp / variance, pv / variance);
        let updated = Self {
            position: self.position + offset * gain_p,
            velocity: self.velocity + offset * gain_v,
            covariance: [pp - gain_p * pp, pv - gain_p * pv, vv - gain_v * pv],
        };
        (updated, -(std::f64::consts::TAU * variance).ln() - offset.dot(offset) / (2.0 * variance))
    }

    /// The smoothed estimate here, `h_s` before the smoothed estimate `next`, for which the prediction was `predicted`.
    fn smoothed(&self, h_s: f64, predicted: &Self, next: &Self) -> Self {
        let ([pp, pv, vv], [app, apv, avv]) = (self.covariance, predicted.covariance);
        let determinant = app * avv - apv * apv;
        if determinant <= 0.0 {
            return *self;
        }
        // The gain P Fᵀ A⁻¹ with F = [1 h; 0 1] and A the predicted covariance.
        let (c00, c01, c10, c11) = (pp + h_s * pv, pv, pv + h_s * vv, vv);
        let g00 = (c00 * avv - c01 * apv) / determinant;
        let g01 = (c01 * app - c00 * apv) / determinant;
        let g10 = (c10 * avv - c11 * apv) / determinant;
        let g11 = (c11 * app - c10 * apv) / determinant;
        let (dp, dv) = (next.position - predicted.position, next.velocity - predicted.velocity);
        let [dpp, dpv, dvv] = [0, 1, 2].map(|i| next.covariance[i] - predicted.covariance[i]);
        let covariance = [
            pp + g00 * g00 * dpp + 2.0 * g00 * g01 * dpv + g01 * g01 * dvv,
            pv + g00 * g10 * dpp + (g00 * g11 + g01 * g10) * dpv + g01 * g11 * dvv,
            vv + g10 * g10 * dpp + 2.0 * g10 * g11 * dpv + g11 * g11 * dvv,
        ];
        Self {
            position: self.position + dp * g00 + dv * g01,
            velocity: self.velocity + dp * g10 + dv * g11,
            covariance,
        }
    }
}

/// The smoothed estimates at all `nodes`, by ascending time. They continue from `before`, an estimate with its time, or
/// otherwise begin with the first recorded position.
pub(super) fn smooth(nodes: &[Node], noise_m: f64, before: Option<(f64, Estimate)>) -> Vec<Estimate> {
    let mut steps = Vec::with_capacity(nodes.len());
    filter(nodes, noise_m, before, &mut |predicted, updated| steps.push((predicted, updated)));
    let mut estimates: Vec<Estimate> = steps.iter().map(|(_, updated)| *updated).collect();
    for i in (1..nodes.len()).rev() {
        let h_s = nodes[i].time_s - nodes[i - 1].time_s;
        estimates[i - 1] = estimates[i - 1].smoothed(h_s, &steps[i].0, &estimates[i]);
    }
    estimates
}

/// The likeliest standard deviation of the recorded positions, meters.
pub(super) fn likeliest_noise_m(nodes: &[Node]) -> f64 {
    let posterior = |noise_m: f64| {
        let deviation = (noise_m / NOISE_MEDIAN_M).ln() / NOISE_LOG_STD;
        filter(nodes, noise_m, None, &mut |_, _| {}) - deviation * deviation / 2.0
    };
    let by_posterior = |a: &f64, b: &f64| posterior(*a).total_cmp(&posterior(*b));
    NOISE_M.into_iter().max_by(by_posterior).unwrap_or(NOISE_MEDIAN_M)
}

/// Calls back with the estimates at each node before and after its position, and returns the log-likelihood of all
/// positions, in nats.
fn filter(
    nodes: &[Node],
    noise_m: f64,
    before: Option<(f64, Estimate)>,
    tell: &mut dyn FnMut(Estimate, Estimate),
) -> f64 {
    let first = nodes.iter().find_map(|node| node.recorded).unwrap_or(Vec2::ZERO);
    let start_s = nodes.first().map_or(0.0, |node| node.time_s);
    let (mut time_s, mut estimate) = before.unwrap_or_else(|| (start_s, Estimate::at_start(first)));
    let mut log_likelihood = 0.0;
    for node in nodes {
        let predicted = estimate.predicted(node.time_s - time_s);
        let (updated, added) = node.recorded.map_or((predicted, 0.0), |recorded| predicted.updated(recorded, noise_m));
        tell(predicted, updated);
        (time_s, estimate) = (node.time_s, updated);
        log_likelihood += added;
    }
    log_likelihood
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    /// Written by `scripts/check_track_smoother.py`, which solves for all states at once.
    #[derive(Deserialize)]
    struct Reference {
        noise_m: f64,
        time_s: Vec<f64>,
        /// Missing if only the state is estimated there.
        recorded: Vec<Option<[f64; 2]>>,
        position_m: Vec<[f64; 2]>,
        velocity_mps: Vec<[f64; 2]>,
        velocity_std_mps: Vec<f64>,
        log_likelihood: f64,
        likeliest_noise_m: f64,
    }

    #[test]
    fn estimates_are_those_of_one_large_system_of_equations() {
        let text = include_str!("../../../tests/fixtures/smoother/references.json");
        let references: Vec<Reference> = serde_json::from_str(text).unwrap();
        assert_eq!(references.len(), 5);
        for reference in references {
            let point = |[x, y]: [f64; 2]| Vec2::new(x, y);
            let node =
                |(time_s, recorded): (&f64, &Option<[f64; 2]>)| Node { time_s: *time_s, recorded: recorded.map(point) };
            let nodes: Vec<Node> = reference.time_s.iter().zip(&reference.recorded).map(node).collect();
            let estimates = smooth(&nodes, reference.noise_m, None);
            for (i, estimate) in estimates.iter().enumerate() {
                assert!(estimate.position.distance(point(reference.position_m[i])) < 1e-7, "{i}");
                assert!(estimate.velocity.distance(point(reference.velocity_mps[i])) < 1e-6, "{i}");
                assert!((estimate.covariance[2].sqrt() - reference.velocity_std_mps[i]).abs() < 1e-6, "{i}");
            }
            let log_likelihood = filter(&nodes, reference.noise_m, None, &mut |_, _| {});
            assert!((log_likelihood - reference.log_likelihood).abs() < 1e-6, "{log_likelihood}");
            assert_eq!(likeliest_noise_m(&nodes), reference.likeliest_noise_m);
        }
    }

    #[test]
    fn who_goes_on_for_certain_goes_on_exactly() {
        let start = Estimate { position: Vec2::new(3.0, 4.0), velocity: Vec2::new(5.0, 0.0), covariance: [0.0; 3] };
        let node = |time_s: f64, x: f64| Node { time_s, recorded: Some(Vec2::new(x, 4.0)) };
        // Recorded half a meter ahead: the track gets there without a jump.
        let nodes: Vec<Node> = (1..=20).map(|i| node(0.1 * f64::from(i), 3.5 + 0.5 * f64::from(i))).collect();
        let estimates = smooth(&nodes, 0.1, Some((0.0, start)));
        assert!(estimates[0].position.distance(Vec2::new(3.5, 4.0)) < 0.15);
        assert!((estimates[19].position.x - 13.5).abs() < 0.05);
        // A jump of half a meter within 0.1 s would take 50 m/s².
        let steps = estimates.windows(2).map(|pair| (pair[1].velocity - pair[0].velocity).norm() / 0.1);
        assert!(steps.fold(0.0, f64::max) < 15.0);
    }
}
