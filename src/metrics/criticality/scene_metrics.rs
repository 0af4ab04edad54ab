//! Criticality of the worst pair of a scene, as metrics.

use super::SceneCriticality;
use crate::metrics::{Direction, Metric, MetricSpec, SampleGroup};

/// A measure of the worst pair of each sample; the mean over the samples for which it is defined.
#[derive(Debug, Clone, Copy)]
pub enum SceneMetric {
    /// Least time to collision.
    MinTtc,
    /// Largest deceleration rate to avoid a crash.
    MaxDrac,
}

impl Metric for SceneMetric {
    fn spec(&self) -> MetricSpec {
        let (id, unit, description) = match self {
            Self::MinTtc => {
                ("scene_min_ttc_s", "s", "least time to collision of any two agents; samples without one left out")
            }
            Self::MaxDrac => (
                "scene_max_drac_mps2",
                "m/s^2",
                "largest deceleration rate to avoid a crash of any two agents; critical above 3.35",
            ),
        };
        MetricSpec::new(id, unit, Direction::Neither, description)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.mean_over_whole(|sample| {
            let worst = SceneCriticality::of(sample)?;
            match self {
                Self::MinTtc => worst.min_ttc_s,
                Self::MaxDrac => Some(worst.max_drac_mps2),
            }
        })
    }
}
