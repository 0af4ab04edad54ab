//! minFDE of the ego: its distance from the recording at the end, in the best sample.

use super::min_ade::ego_fde_m;
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};

/// minFDE of the ego: the least displacement at the last timestep of all samples. Not defined if the ego is not
/// recorded then. The minFDE of Argoverse 1 and 2 and of INTERACTION's single-agent benchmark.
#[derive(Debug, Clone, Copy)]
pub struct MinFde;

impl Metric for MinFde {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "min_fde_m",
            "m",
            Direction::LowerIsBetter,
            "ego: distance to the recording at the last timestep, in the best sample",
        )
        .over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.min_over_samples(|sample| ego_fde_m(group.recorded, sample))
    }
}
