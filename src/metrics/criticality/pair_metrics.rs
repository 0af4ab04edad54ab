//! Criticality of the requested pair, as metrics.

use super::PairCriticality;
use crate::metrics::{Direction, Metric, MetricSpec, SampleGroup};

/// A measure of the agents that have the first two roles of the request; the mean over the samples for which it is
/// defined. Not defined if fewer than two agents were requested.
#[derive(Debug, Clone, Copy)]
pub enum PairMetric {
    /// Least time to collision.
    MinTtc,
    /// Largest deceleration rate to avoid a crash.
    MaxDrac,
    /// Least time headway.
    MinHeadway,
    /// Post-encroachment time.
    Pet,
    /// Smallest distance.
    MinDistance,
}

impl PairMetric {
    fn of(self, criticality: &PairCriticality) -> Option<f64> {
        match self {
            Self::MinTtc => criticality.min_ttc_s,
            Self::MaxDrac => Some(criticality.max_drac_mps2),
            Self::MinHeadway => criticality.min_headway_s,
            Self::Pet => criticality.pet_s,
            Self::MinDistance => Some(criticality.min_distance_m),
        }
    }
}

impl Metric for PairMetric {
    fn spec(&self) -> MetricSpec {
        let (id, unit, description) = match self {
            Self::MinTtc => {
                ("pair_min_ttc_s", "s", "least time to collision of the requested agents; samples without one left out")
            }
            Self::MaxDrac => (
                "pair_max_drac_mps2",
                "m/s^2",
                "largest deceleration rate to avoid a crash of the requested agents; critical above 3.35",
            ),
            Self::MinHeadway => {
                ("pair_min_headway_s", "s", "least time headway of the requested agents; samples without one left out")
            }
            Self::Pet => {
                ("pair_pet_s", "s", "post-encroachment time of the requested agents; samples without one left out")
            }
            Self::MinDistance => ("pair_min_distance_m", "m", "smallest distance between the requested agents"),
        };
        MetricSpec::new(id, unit, Direction::Neither, description)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let [(_, first), (_, second), ..] = &**group.asked else { return None };
        group.mean_over_whole(|sample| {
            let pair = [sample.track_idx(first)?, sample.track_idx(second)?];
            self.of(&PairCriticality::of(sample, pair)?)
        })
    }
}
