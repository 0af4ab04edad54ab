//! Affine maps of feature vectors: y = W x + b, with an optional ReLU.

use candle_core::{Result, Tensor};

use super::ops::{self, Activation};
use super::params::{Init, Scope};
use super::precision::Precision;

/// An affine map of the last dimension, with the tensor names and the initialization of `torch.nn.Linear`.
#[derive(Debug, Clone)]
pub struct Linear {
    weight: Tensor,
    bias: Tensor,
    precision: Precision,
}

impl Linear {
    /// A map from `n_in` to `n_out` features, with parameters `weight` (`n_out`, `n_in`) and `bias` (`n_out`).
    pub fn new(scope: &mut Scope<'_>, name: &str, n_in: usize, n_out: usize) -> Result<Self> {
        let mut scope = scope.enter(name);
        let init = Init::KaimingUniform { fan_in: n_in };
        let weight = scope.tensor("weight", &[n_out, n_in], init)?;
        let bias = scope.tensor("bias", &[n_out], init)?;
        Ok(Self { weight, bias, precision: scope.precision() })
    }

    /// W x + b: (.., `n_in`) to (.., `n_out`).
    ///
    /// # Errors
    /// When the last dimension is not `n_in`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.apply(x, Activation::None, None)
    }

    /// As [`forward`](Self::forward) where `valid` (..) is 1, and exactly 0 elsewhere, without work on those rows.
    ///
    /// # Errors
    /// When the last dimension is not `n_in` or the leading ones are not those of `valid`.
    pub fn forward_valid(&self, x: &Tensor, valid: &Tensor) -> Result<Tensor> {
        self.apply(x, Activation::None, Some(valid))
    }

    pub(super) fn apply(&self, x: &Tensor, activation: Activation, valid: Option<&Tensor>) -> Result<Tensor> {
        ops::linear(x, &self.weight, &self.bias, activation, valid, self.precision)
    }
}
