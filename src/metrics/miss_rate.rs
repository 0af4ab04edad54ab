//! Miss rate: whether no sample ends near the ego's recorded position.

use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};
use crate::scene::{MissRule, State};

/// Thresholds of a miss along the motion of a slow and a fast vehicle, meters, and their speeds, m/s (INTERACTION).
const LONGITUDINAL_M: [f64; 2] = [1.0, 2.0];
const SPEEDS_MPS: [f64; 2] = [1.4, 11.0];
/// Threshold of a miss across the motion, meters (INTERACTION).
const LATERAL_M: f64 = 1.0;
/// Threshold of a miss in any direction, meters (Argoverse).
const RADIAL_M: f64 = 2.0;

/// Miss rate of the ego: 1 if every sample misses at the last timestep, else 0.
///
/// By INTERACTION's rule a sample misses if, along the axes of the recorded heading at the last timestep, it is off by
/// more than 1 m sideways or by more than a threshold lengthwise: 1 m below 1.4 m/s, 2 m from 11 m/s, linear between,
/// for the recorded speed at the last timestep. For Argoverse, a sample misses if it is off by more than 2 m. This is
/// the miss rate of INTERACTION's single-agent benchmark, and the MR of Argoverse.
#[derive(Debug, Clone, Copy)]
pub struct MissRate;

impl Metric for MissRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "miss_rate",
            "1",
            Direction::LowerIsBetter,
            "ego: share of scenes in which every sample misses the recorded last state",
        )
        .over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let recorded = group.recorded;
        let last = recorded.n_timesteps.checked_sub(1).filter(|_| recorded.has_future())?;
        let truth = recorded.state(recorded.ego_idx, last)?;
        group.min_over_samples(|sample| {
            let sampled = sample.state(recorded.ego_idx, last)?;
            Some(if is_miss(recorded.source.dataset.facts().miss_rule, truth, sampled) { 1.0 } else { 0.0 })
        })
    }
}

/// Whether a sampled last state misses the recorded one.
pub(super) fn is_miss(rule: MissRule, truth: &State, sampled: &State) -> bool {
    let error = (sampled.position - truth.position).rotated(-truth.heading_rad);
    match rule {
        MissRule::AlongHeading => error.y.abs() > LATERAL_M || error.x.abs() > longitudinal_limit_m(truth.speed_mps()),
        MissRule::Radial => error.norm() > RADIAL_M,
    }
}

fn longitudinal_limit_m(speed_mps: f64) -> f64 {
    let share = ((speed_mps - SPEEDS_MPS[0]) / (SPEEDS_MPS[1] - SPEEDS_MPS[0])).clamp(0.0, 1.0);
    LONGITUDINAL_M[0] + (LONGITUDINAL_M[1] - LONGITUDINAL_M[0]) * share
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;

    #[test]
    fn thresholds_follow_speed_and_heading() {
        assert_eq!([0.0, 1.4, 6.2, 11.0, 30.0].map(longitudinal_limit_m), [1.0, 1.0, 1.5, 2.0, 2.0]);
        // Facing north at 6.2 m/s: 1.5 m lengthwise is along y.
        let heading_rad = std::f64::consts::FRAC_PI_2;
        let truth = State { heading_rad, velocity: Vec2::new(0.0, 6.2), ..State::default() };
        let misses = |rule: MissRule, x: f64, y: f64| {
            is_miss(rule, &truth, &State { position: Vec2::new(x, y), ..State::default() })
        };
        assert!(!misses(MissRule::AlongHeading, 0.99, 1.49));
        assert!(misses(MissRule::AlongHeading, 1.01, 0.0));
        assert!(misses(MissRule::AlongHeading, 0.0, -1.51));
        assert!(!misses(MissRule::Radial, 1.4, 1.4));
        assert!(misses(MissRule::Radial, 1.5, 1.5));
    }
}
