//! p_φ(y | x; σ): does this pair of agents, seen through noise, perform the behavior? (Paper, section 6.3.)

use crate::diffusion::{Edm, sigma_rows};
use crate::nn::{Mlp, Params, Scope, sinusoidal};
use crate::seed::Seed;
use crate::tensor::PairFeatures;
use candle_core::{Result, Tensor};
use serde::{Deserialize, Serialize};

/// Shape of the classifier.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BehaviorClassifierConfig {
    /// Features of each hidden layer (the paper's 128).
    pub width: usize,
    /// Number of hidden layers (the paper's 2).
    pub n_hidden: usize,
    /// Features of the sinusoidal encoding of the noise level; even.
    pub encoding: usize,
}

impl Default for BehaviorClassifierConfig {
    fn default() -> Self {
        Self { width: 128, n_hidden: 2, encoding: 16 }
    }
}

/// Shortest and longest encoding periods of c_noise, which lies in [-1.55, 1.10]: the probability of a behavior changes
/// slowly with the noise level, so shorter periods would only invite overfitting.
const NOISE_PERIODS: (f64, f64) = (1.0, 8.0);

/// The paper's noise-aware classifier: a perceptron over the diffused trajectories of both agents, the validity of each
/// timestep and the noise level.
#[derive(Debug, Clone)]
pub struct BehaviorClassifier {
    mlp: Mlp,
    encoding: usize,
    edm: Edm,
}

impl BehaviorClassifier {
    /// A classifier of pairs over `n_timesteps` with `state_dim` diffused dimensions, whose parameters live in
    /// `params`; missing ones are drawn from `seed`.
    ///
    /// # Errors
    /// Fails when the parameters exist with other shapes.
    pub fn new(
        params: &mut Params,
        config: &BehaviorClassifierConfig,
        n_timesteps: usize,
        state_dim: usize,
        edm: Edm,
        seed: Seed,
    ) -> Result<Self> {
        let mut dims = vec![PairFeatures::n_features(n_timesteps, state_dim) + config.encoding];
        dims.extend(std::iter::repeat_n(config.width, config.n_hidden));
        dims.push(1);
        let mlp = Mlp::new(&mut Scope::root(params, seed), "classifier", &dims)?;
        Ok(Self { mlp, encoding: config.encoding, edm })
    }

    /// ln p / (1 - p) of the behavior for each pair, (B). `x` (B, A, T, D) are diffused states at the noise levels
    /// `sigma` (B), of the batch that `features` was made for. Differentiable in `x`.
    ///
    /// # Errors
    /// Fails when shapes do not fit.
    pub fn logits(&self, features: &PairFeatures, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let pairs = features.forward(x, sigma)?;
        let c_noise: Vec<f32> = sigma_rows(sigma)?.into_iter().map(|s| self.edm.c_noise(s) as f32).collect();
        let c_noise = Tensor::new(c_noise, x.device())?;
        let noise = sinusoidal(&c_noise, self.encoding, NOISE_PERIODS.0, NOISE_PERIODS.1)?.to_dtype(pairs.dtype())?;
        self.mlp.forward(&Tensor::cat(&[&pairs, &noise], 1)?)?.squeeze(1)
    }
}

/// ln(1 / (1 + exp(-z))) without overflow: the log probability that belongs to a logit (B).
pub fn log_sigmoid(logits: &Tensor) -> Result<Tensor> {
    // -ln(exp(0) + exp(-z)). The usual form with |z| and max(z, 0) has the wrong slope at exactly 0 in candle, where
    // the subgradients of its parts do not cancel.
    Tensor::stack(&[logits.zeros_like()?, logits.neg()?], 1)?.log_sum_exp(1)?.neg()
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    #[test]
    fn log_probabilities_are_exact_far_out_and_differentiable() {
        let logits = Var::new(&[-200.0f64, -1.0, 0.0, 2.0, 200.0], &Device::Cpu).unwrap();
        let log_p = log_sigmoid(logits.as_tensor()).unwrap();
        let expected = [-200.0, -(1.0 + 1f64.exp()).ln(), -(2f64.ln()), -(1.0 + (-2f64).exp()).ln(), 0.0];
        for (got, expected) in log_p.to_vec1::<f64>().unwrap().iter().zip(expected) {
            assert!((got - expected).abs() < 1e-12, "got {got}, expected {expected}");
        }
        // d ln p / dz = 1 - p.
        let gradient = log_p.sum_all().unwrap().backward().unwrap();
        let gradient = gradient.get(logits.as_tensor()).unwrap().to_vec1::<f64>().unwrap();
        for (z, slope) in [-200.0, -1.0, 0.0, 2.0, 200.0f64].iter().zip(gradient) {
            let expected = 1.0 - 1.0 / (1.0 + (-z).exp());
            assert!((slope - expected).abs() < 1e-12, "at {z}: {slope}, expected {expected}");
        }
    }
}
