//! Do vehicles leave the road?

use super::road::Road;
use super::sample_group::{future, present_agents};
use super::{Direction, Metric, MetricSpec, SampleGroup};
use crate::scene::Scene;
use std::collections::BTreeSet;

/// Off-road rate: the share of motorized agents on the road at present, over all samples, that leave it.
///
/// An agent is on the road if its center is within the outline of any lane, or at most 0.3 m outside; for lanes without
/// boundaries, if it is at most 1.9 m from the center line. Beyond the map's end the road is unknown, so lanes are
/// extended straight beyond ends that no lane continues. Not defined for scenes without lanes, and at places whose map
/// lacks parts of the road.
#[derive(Debug, Clone)]
pub struct OffroadRate {
    /// The places whose maps lack parts of the road.
    pub places_without_road: BTreeSet<String>,
}

impl Metric for OffroadRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "offroad_rate",
            "1",
            Direction::LowerIsBetter,
            "share of vehicles on the road at present, over all samples, that leave it",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let is_judged = !self.places_without_road.contains(&group.recorded.source.place);
        if !is_judged || group.recorded.lanes.is_empty() || !group.recorded.has_future() {
            return None;
        }
        let road = Road::new(&group.recorded.lanes);
        group.share_over_samples(|sample| leaves(&road, sample))
    }
}

/// For every motorized agent on the road at present, whether it leaves the road.
fn leaves(road: &Road, scene: &Scene) -> Vec<bool> {
    let is_on_road = |agent_idx: usize, timestep: usize| {
        scene.state(agent_idx, timestep).map(|state| state.position.is_finite() && road.holds(state.position))
    };
    let present = scene.current_timestep();
    present_agents(scene)
        .filter(|agent_idx| scene.tracks[*agent_idx].class.is_motorized())
        .filter(|agent_idx| is_on_road(*agent_idx, present) == Some(true))
        .map(|agent_idx| future(scene).any(|timestep| is_on_road(agent_idx, timestep) == Some(false)))
        .collect()
}
