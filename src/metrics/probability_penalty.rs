//! Distances of the ego in the best sample, with a penalty for the sample's probability.

use super::min_ade::{ego_ade_m, ego_fde_m};
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};

/// Lower probabilities get the penalty of this one (Argoverse 1).
const LEAST_PROBABILITY: f64 = 0.05;

/// Which distance is penalized.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Displacement {
    /// The mean over the future.
    Ade,
    /// The distance at the last timestep.
    Fde,
}

/// The penalty for a best sample of probability p.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Penalty {
    /// -ln p, at most -ln 0.05.
    Logarithm,
    /// (1 - p)².
    Brier,
}

/// A distance in the sample of the ego that ends closest to the recording (of equally close ones the first), plus a
/// penalty for its probability: p-minADE, p-minFDE, brier-minADE and brier-minFDE of Argoverse 1; brier-minFDE is
/// Argoverse 2's too. Probabilities are scaled to a sum of 1 over the samples. Samples without probabilities are
/// equally likely, and the penalty depends on their number alone.
#[derive(Debug, Clone, Copy)]
pub struct PenalizedMinimum(
    /// The distance.
    pub Displacement,
    /// The penalty.
    pub Penalty,
);

impl Metric for PenalizedMinimum {
    fn spec(&self) -> MetricSpec {
        let (id, description) = match (self.0, self.1) {
            (Displacement::Ade, Penalty::Logarithm) => (
                "p_min_ade_m",
                "Argoverse's p-minADE: min_ade_of_min_fde_m plus -ln p of that sample, at most -ln 0.05",
            ),
            (Displacement::Fde, Penalty::Logarithm) => {
                ("p_min_fde_m", "Argoverse's p-minFDE: min_fde_m plus -ln p of that sample, at most -ln 0.05")
            }
            (Displacement::Ade, Penalty::Brier) => {
                ("brier_min_ade_m", "Argoverse's brier-minADE: min_ade_of_min_fde_m plus (1 - p)² of that sample")
            }
            (Displacement::Fde, Penalty::Brier) => {
                ("brier_min_fde_m", "Argoverse's brier-minFDE: min_fde_m plus (1 - p)² of that sample")
            }
        };
        MetricSpec::new(id, "m", Direction::LowerIsBetter, description).over_modes(ModesOf::Ego)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let (best, fde_m) = group.best_sample(|sample| ego_fde_m(group.recorded, sample))?;
        let distance_m = match self.0 {
            Displacement::Ade => ego_ade_m(group.recorded, &group.samples[best])?,
            Displacement::Fde => fde_m,
        };
        let probability = group.probability(best)?;
        let penalty = match self.1 {
            Penalty::Logarithm => -probability.max(LEAST_PROBABILITY).ln(),
            Penalty::Brier => (1.0 - probability) * (1.0 - probability),
        };
        Some(distance_m + penalty)
    }
}
