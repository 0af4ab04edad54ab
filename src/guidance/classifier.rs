//! Classifier guidance: make a behavior likely for chosen pairs of agents (paper, section 5.2).

use super::Guidance;
use crate::model::{BehaviorClassifier, log_sigmoid};
use crate::tensor::PairFeatures;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The output of the classifier to maximize: log p or log odds. With z = ln p / (1 - p), ∇ ln p = (1 - p) ∇z: while p
/// is small, both potentials push alike, with ∇z. Once the classifier is sure, ln p lets go, and the log odds push on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierPotential {
    /// ln p, whose gradient is that of the conditional distribution (paper, section 5.2).
    #[default]
    LogProbability,
    /// ln p / (1 - p), which has no best value: `guidance.max_shift` and the strength limit it.
    LogOdds,
}

impl ClassifierPotential {
    /// Whether it is the default, which need not be named.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The potential of logits z.
    pub(super) fn of_logits(self, logits: Tensor) -> Result<Tensor> {
        match self {
            Self::LogProbability => log_sigmoid(&logits),
            Self::LogOdds => Ok(logits),
        }
    }
}

/// ln p_φ(y | x; σ), or its log odds, for one chosen pair of agents in each batch row.
#[derive(Debug, Clone)]
pub struct ClassifierGuidance<'a> {
    /// The classifier of the behavior.
    pub classifier: &'a BehaviorClassifier,
    /// The features of the chosen pairs, one for each row of the batch that is sampled.
    pub pairs: PairFeatures,
    /// The classifier output to maximize.
    pub potential: ClassifierPotential,
}

impl Guidance for ClassifierGuidance<'_> {
    fn log_potential(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        self.potential.of_logits(self.classifier.logits(&self.pairs, x, sigma)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    /// d ln p / dz = 1 - p, which is nearly 1 where p is nearly 0 and nearly 0 where p is nearly 1; the derivative of
    /// the log odds is 1.
    #[test]
    fn log_p_lets_go_of_what_it_is_sure_of_and_log_odds_do_not() {
        let slopes = |potential: ClassifierPotential| {
            let z = Var::new(&[-40.0f64, 0.0, 3.0, 40.0], &Device::Cpu).unwrap();
            let total = potential.of_logits(z.as_tensor().clone()).unwrap().sum_all().unwrap();
            total.backward().unwrap().get(z.as_tensor()).unwrap().to_vec1::<f64>().unwrap()
        };
        let expected = [1.0, 0.5, 1.0 / (1.0 + 3f64.exp()), (-40f64).exp()];
        for (slope, expected) in slopes(ClassifierPotential::LogProbability).iter().zip(expected) {
            assert!((slope - expected).abs() < 1e-15, "{slope}, expected {expected}");
        }
        assert_eq!(slopes(ClassifierPotential::LogOdds), [1.0; 4]);
    }
}
