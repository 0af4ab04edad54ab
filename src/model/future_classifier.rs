//! p_φ(y | x₀): does this pair of agents perform the behavior in a clean future?

use super::BehaviorClassifierConfig;
use crate::nn::{Mlp, Params, Scope};
use crate::seed::Seed;
use crate::tensor::{FutureFeatures, Moments};
use candle_core::{Result, Tensor};

/// What takes a moment out of a maximum.
const NO_MOMENT: f64 = -1e9;

/// A classifier of clean futures. One perceptron sees each moment together with the present; the mean and the smooth maximum
/// (ln of the mean of exponentials) of its outputs over time go to a second perceptron, which judges the whole.
///
/// A behavior is what the present turns into: an offset from a lane that was another one, a speed that was higher. A network over
/// moments has few parameters, and its gradient treats all moments alike.
#[derive(Debug, Clone)]
pub struct FutureClassifier {
    moment: Mlp,
    whole: Mlp,
}

impl FutureClassifier {
    /// A classifier whose parameters live in `params`; those that are not there yet are drawn from `seed`.
    ///
    /// # Errors
    /// When the parameters exist with other shapes.
    pub fn new(params: &mut Params, config: &BehaviorClassifierConfig, seed: Seed) -> Result<Self> {
        let mut scope = Scope::root(params, seed);
        let mut dims = vec![2 * FutureFeatures::MOMENT];
        dims.extend(std::iter::repeat_n(config.width, config.n_hidden.max(1)));
        Ok(Self {
            moment: Mlp::new(&mut scope, "moment", &dims)?,
            whole: Mlp::new(&mut scope, "whole", &[2 * config.width, config.width, 1])?,
        })
    }

    /// ln p / (1 - p) of the behavior for each pair, (B). Differentiable in the features. Without a moment in which both have a state, the
    /// logit of nothing.
    ///
    /// # Errors
    /// When shapes do not fit.
    pub fn logits(&self, Moments { features, valid }: &Moments) -> Result<Tensor> {
        let present = features.narrow(1, 0, 1)?.broadcast_as(features.shape())?;
        let seen = self.moment.forward(&Tensor::cat(&[features.clone(), present.contiguous()?], 2)?)?;
        let (counts, n) = (valid.unsqueeze(2)?, valid.sum_keepdim(1)?);
        let any = n.minimum(1.0)?;
        let n = n.maximum(1.0)?;
        let mean = seen.broadcast_mul(&counts)?.sum(1)?.broadcast_div(&n)?;
        let hidden = counts.affine(-NO_MOMENT, NO_MOMENT)?;
        let largest = seen.broadcast_add(&hidden)?.log_sum_exp(1)?.broadcast_sub(&n.log()?)?;
        let pooled = Tensor::cat(&[mean, largest.broadcast_mul(&any)?], 1)?;
        self.whole.forward(&pooled)?.squeeze(1)
    }
}
