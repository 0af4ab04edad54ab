//! Rates of accelerations and jerks beyond limits.

use super::sample_group::{future, present_agents};
use super::{Direction, Metric, MetricSpec, SampleGroup};
use crate::geometry::Vec2;
use crate::scene::Scene;

/// Accelerations beyond this occur only in emergencies, m/s².
const MAX_ACCELERATION_MPS2: f64 = 8.0;
/// Jerks beyond this are uncomfortable, m/s³ (nuPlan's bound).
const MAX_JERK_MPS3: f64 = 8.37;
/// Time between the positions whose differences are taken, seconds: short enough for a brake stab, long enough for the
/// noise of positions to stay small.
const STRIDE_S: f64 = 0.3;

/// Acceleration violation rate: over all samples, the share of motorized agents tracked at present whose acceleration
/// exceeds 8 m/s² in size. From second differences of positions 0.3 s apart, the last of which lies in the future: the
/// step from history to future counts.
#[derive(Debug, Clone, Copy)]
pub struct AccelerationViolationRate;

/// Jerk violation rate: the share whose jerk exceeds 8.37 m/s³, from third differences of positions 0.3 s apart.
#[derive(Debug, Clone, Copy)]
pub struct JerkViolationRate;

impl Metric for AccelerationViolationRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "acceleration_violation_rate",
            "1",
            Direction::LowerIsBetter,
            "share of vehicles, over all samples, that accelerate by more than 8 m/s² in any direction",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.share_over_samples(|sample| exceeds(sample, &[1.0, -2.0, 1.0], MAX_ACCELERATION_MPS2))
    }
}

impl Metric for JerkViolationRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "jerk_violation_rate",
            "1",
            Direction::LowerIsBetter,
            "share of vehicles, over all samples, with a jerk of more than 8.37 m/s³ in any direction",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.share_over_samples(|sample| exceeds(sample, &[-1.0, 3.0, -3.0, 1.0], MAX_JERK_MPS3))
    }
}

/// For every motorized agent tracked at present with such a difference of positions in the future, whether any of these
/// differences exceeds `limit` (in meters per second to the power of the order of the difference) or is NaN.
fn exceeds(scene: &Scene, weights: &[f64], limit: f64) -> Vec<bool> {
    let stride = (STRIDE_S / scene.dt_s).round().max(1.0) as usize;
    let order = weights.len() - 1;
    let unit = (stride as f64 * scene.dt_s).powi(order as i32);
    let difference = |agent_idx: usize, last: usize| -> Option<f64> {
        let first = last.checked_sub(order * stride)?;
        let mut sum = Vec2::ZERO;
        for (i, weight) in weights.iter().enumerate() {
            sum = sum + scene.state(agent_idx, first + i * stride)?.position * *weight;
        }
        Some(sum.norm() / unit)
    };
    let differences =
        |agent_idx: usize| -> Vec<f64> { future(scene).filter_map(|last| difference(agent_idx, last)).collect() };
    present_agents(scene)
        .filter(|agent_idx| scene.tracks[*agent_idx].class.is_motorized())
        .map(differences)
        .filter(|differences| !differences.is_empty())
        .map(|differences| differences.iter().any(|size| size.is_nan() || *size > limit))
        .collect()
}
