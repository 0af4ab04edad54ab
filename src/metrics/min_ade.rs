//! minADE of the ego: its mean distance from the recording, in the best sample.

use super::displacement::{displacements_m, final_displacement_m, mean};
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};
use crate::scene::Scene;

/// minADE of the ego: the least average displacement of all samples, chosen independently of minFDE. If the ego is the
/// agent to predict, it is the minADE of INTERACTION's single-agent benchmark.
#[derive(Debug, Clone, Copy)]
pub struct MinAde;

impl Metric for MinAde {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "min_ade_m",
            "m",
            Direction::LowerIsBetter,
            "ego: mean distance to the recording over the future, in the best sample",
        )
        .over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.min_over_samples(|sample| ego_ade_m(group.recorded, sample))
    }
}

/// The ADE of the ego in the sample with the least FDE, which Argoverse 1's own evaluation calls minADE. Among samples
/// with the same FDE, the first counts.
#[derive(Debug, Clone, Copy)]
pub struct MinAdeOfMinFde;

impl Metric for MinAdeOfMinFde {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "min_ade_of_min_fde_m",
            "m",
            Direction::LowerIsBetter,
            "ego: mean distance to the recording over the future, in the sample that ends closest",
        )
        .over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let (best, _) = group.best_sample(|sample| ego_fde_m(group.recorded, sample))?;
        ego_ade_m(group.recorded, &group.samples[best])
    }
}

/// The mean displacement of the ego over the future, meters.
pub(super) fn ego_ade_m(recorded: &Scene, sample: &Scene) -> Option<f64> {
    mean(&displacements_m(recorded, sample, recorded.ego_idx)?)
}

/// The displacement of the ego at the last timestep, meters.
pub(super) fn ego_fde_m(recorded: &Scene, sample: &Scene) -> Option<f64> {
    final_displacement_m(recorded, sample, recorded.ego_idx)
}
