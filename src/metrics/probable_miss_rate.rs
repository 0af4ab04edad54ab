//! Argoverse's p-MR: misses, and the probability of the sample that does not miss.

use super::min_ade::ego_fde_m;
use super::miss_rate::is_miss;
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};

/// p-MR of Argoverse 1: 1 if every sample misses, else 1 - p of the sample of the ego that ends closest to the
/// recording (the first of equals). Probabilities are scaled to a sum of 1 over the samples. Misses follow the
/// dataset's rule, as in [`super::MissRate`]; by Argoverse's rule the closest sample misses exactly if all do.
#[derive(Debug, Clone, Copy)]
pub struct ProbableMissRate;

impl Metric for ProbableMissRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "p_miss_rate",
            "1",
            Direction::LowerIsBetter,
            "Argoverse's p-MR: 1 where every sample of the ego misses the recorded last state, else 1 - p \
                          of the sample that ends closest to it",
        )
        .over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let recorded = group.recorded;
        let last = recorded.n_timesteps.checked_sub(1).filter(|_| recorded.has_future())?;
        let truth = recorded.state(recorded.ego_idx, last)?;
        let (best, _) = group.best_sample(|sample| ego_fde_m(recorded, sample))?;
        let all_miss = group.min_over_samples(|sample| {
            let sampled = sample.state(recorded.ego_idx, last)?;
            Some(if is_miss(recorded.source.dataset.facts().miss_rule, truth, sampled) { 1.0 } else { 0.0 })
        })?;
        if all_miss > 0.0 { Some(1.0) } else { Some(1.0 - group.probability(best)?) }
    }
}
