//! Layer normalization: feature vectors of mean 0 and variance 1, scaled and shifted.

use candle_core::{Result, Tensor};

use super::ops;
use super::params::{Init, Scope};

/// Added to the variance, as in `torch.nn.LayerNorm`.
const EPSILON: f64 = 1e-5;

/// Layer normalization over the last dimension (Ba et al. 2016), differentiable unlike candle's own.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
}

impl LayerNorm {
    /// A normalization of `dim` features, with parameters `weight` (ones) and `bias` (zeros).
    pub fn new(scope: &mut Scope<'_>, name: &str, dim: usize) -> Result<Self> {
        let mut scope = scope.enter(name);
        Ok(Self {
            weight: scope.tensor("weight", &[dim], Init::Ones)?,
            bias: scope.tensor("bias", &[dim], Init::Zeros)?,
        })
    }

    /// (x - mean) / √(variance + 1e-5) · weight + bias over the last dimension of x (.., `dim`).
    ///
    /// # Errors
    /// When the last dimension is not `dim`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::layer_norm(x, &self.weight, &self.bias, EPSILON)
    }
}
