//! Maximum final distance: how different the samples of a scene are.

use super::displacement::mean;
use super::sample_group::{future, present_agents};
use super::{Direction, Metric, MetricSpec, SampleGroup};
use crate::geometry::Vec2;

/// MFD: for each agent the largest distance between its last positions in any two samples, averaged over the sampled
/// agents. (A scene may have more agents than a denoiser continues.) Defined for two samples and more; the recorded
/// future does not matter.
#[derive(Debug, Clone, Copy)]
pub struct Mfd;

impl Metric for Mfd {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "mfd_m",
            "m",
            Direction::Neither,
            "largest distance between the last positions of an agent in two samples, mean over sampled \
                          agents",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        if group.samples.len() < 2 {
            return None;
        }
        let last = future(group.recorded).last()?;
        let largest_m = |agent_idx: usize| -> Option<f64> {
            let ends: Option<Vec<Vec2>> =
                group.samples.iter().map(|sample| sample.state(agent_idx, last).map(|state| state.position)).collect();
            let ends = ends?;
            let pairs = ends.iter().enumerate().flat_map(|(i, a)| ends[i + 1..].iter().map(|b| a.distance(*b)));
            pairs.reduce(f64::max)
        };
        let is_sampled =
            |agent_idx: &usize| group.samples.iter().any(|sample| sample.state(*agent_idx, last).is_some());
        let distances: Option<Vec<f64>> = present_agents(group.recorded).filter(is_sampled).map(largest_m).collect();
        mean(&distances?)
    }
}
