//! Classifier guidance toward a behavior of anybody: which pair performs it is left to the sample.

use super::{ClassifierPotential, Guidance};
use crate::model::{BehaviorClassifier, TrainedClassifier};
use crate::tensor::{PairFeatures, SceneBatch};
use candle_core::{Result, Tensor};

/// ln Σ p_φ(y | pair, x; σ) over the candidate pairs of each row: the expected number of pairs that perform the behavior. Its
/// gradient is the soft-max mean of the pairs' own gradients: the pair that is nearest to the behavior is pushed most. With log odds it is
/// the sum of the odds.
#[derive(Debug, Clone)]
pub struct AnyPairGuidance<'a> {
    classifier: &'a BehaviorClassifier,
    /// Features of P pairs a row, (B · P).
    pairs: PairFeatures,
    /// The row of each pair, (B · P).
    rows: Tensor,
    /// 0 for candidates, very low for padding, (B, P).
    offset: Tensor,
    /// 1 for rows with a candidate, (B).
    has_pair: Tensor,
    potential: ClassifierPotential,
}

/// The log probability of a pair that is none.
const NO_PAIR: f32 = -1e9;

impl<'a> AnyPairGuidance<'a> {
    /// Guidance for `batch`, whose row b has the candidates `pairs[b]`, as places on the agent axis. Rows without candidates are
    /// not guided.
    ///
    /// # Errors
    /// When the classifier sees no noisy states, there is no list for each row, or a place lies outside the agent axis.
    pub fn new(
        classifier: &'a TrainedClassifier,
        batch: &SceneBatch,
        pairs: &[Vec<(usize, usize)>],
        potential: ClassifierPotential,
    ) -> Result<Self> {
        let n_rows = batch.n_rows();
        let n_pairs = pairs.iter().map(Vec::len).max().unwrap_or(0).max(1);
        if pairs.len() != n_rows {
            candle_core::bail!("candidate pairs of {} rows given for a batch of {n_rows}", pairs.len());
        }
        let (mut places, mut offset) = (Vec::with_capacity(n_rows * n_pairs), Vec::with_capacity(n_rows * n_pairs));
        for own in pairs {
            places.extend(own.iter().copied().chain(std::iter::repeat((0, 0))).take(n_pairs));
            offset.extend((0..n_pairs).map(|i| if i < own.len() { 0.0 } else { NO_PAIR }));
        }
        let device = batch.x0.device();
        let has_pair: Vec<f32> = pairs.iter().map(|own| f32::from(u8::from(!own.is_empty()))).collect();
        let rows: Vec<u32> = (0..n_rows * n_pairs).map(|at| (at / n_pairs) as u32).collect();
        Ok(Self {
            classifier: classifier.network.of_noisy_states()?,
            pairs: classifier.spec.features(&batch.repeated(n_pairs)?, &places)?,
            rows: Tensor::from_vec(rows, n_rows * n_pairs, device)?,
            offset: Tensor::from_vec(offset, (n_rows, n_pairs), device)?.to_dtype(batch.x0.dtype())?,
            has_pair: Tensor::from_vec(has_pair, n_rows, device)?.to_dtype(batch.x0.dtype())?,
            potential,
        })
    }
}

impl Guidance for AnyPairGuidance<'_> {
    fn log_potential(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let (x, sigma) = (x.index_select(&self.rows, 0)?, sigma.index_select(&self.rows, 0)?);
        let potentials = self.potential.of_logits(self.classifier.logits(&self.pairs, &x, &sigma)?)?;
        (potentials.reshape(self.offset.shape())? + &self.offset)?.log_sum_exp(1)? * &self.has_pair
    }
}
