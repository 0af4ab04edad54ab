//! In how many samples does the ego stay on the road?

use super::road::Road;
use super::sample_group::future;
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};
use crate::scene::Scene;
use std::collections::BTreeSet;

/// Drivable-area compliance (DAC) of Argoverse 1: the share of samples in which the ego is on the road at every future
/// timestep. Unlike [`OffroadRate`](super::OffroadRate), it counts only the ego, on the road at present or not.
///
/// The benchmark looks the area up in a raster of the city. Here the road is the area of the lanes, with the tolerance
/// and the continuation beyond the map's end of the off-road rate, so figures need not agree to the last digit. Not
/// defined for scenes without lanes, and at places whose map lacks parts of the road.
#[derive(Debug, Clone)]
pub struct DrivableAreaCompliance {
    /// The places whose maps lack parts of the road.
    pub places_without_road: BTreeSet<String>,
}

impl Metric for DrivableAreaCompliance {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "drivable_area_compliance",
            "1",
            Direction::HigherIsBetter,
            "Argoverse's DAC, from lanes: share of samples in which the ego never leaves the road",
        )
        .over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let recorded = group.recorded;
        let is_judged = !self.places_without_road.contains(&recorded.source.place);
        if !is_judged || recorded.lanes.is_empty() || !recorded.has_future() {
            return None;
        }
        let road = Road::new(&recorded.lanes);
        let stays = |sample: &Scene| {
            let mut states = future(recorded).filter_map(|timestep| sample.state(recorded.ego_idx, timestep));
            states.all(|state| state.position.is_finite() && road.holds(state.position))
        };
        group.share_over_samples(|sample| vec![stays(sample)])
    }
}
