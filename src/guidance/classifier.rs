//! Classifier guidance: make a behavior likely for chosen pairs of agents (paper, section 5.2).

use super::Guidance;
use crate::model::{BehaviorClassifier, log_sigmoid};
use crate::tensor::PairFeatures;
use candle_core::{Result, Tensor};

/// ln p_φ(y | x; σ) for one chosen pair of agents in each batch row.
#[derive(Debug, Clone)]
pub struct ClassifierGuidance<'a> {
    /// The classifier of the behavior.
    pub classifier: &'a BehaviorClassifier,
    /// The features of the chosen pairs, one for each row of the batch that is sampled.
    pub pairs: PairFeatures,
}

impl Guidance for ClassifierGuidance<'_> {
    fn log_potential(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        log_sigmoid(&self.classifier.logits(&self.pairs, x, sigma)?)
    }
}
