//! Multilayer perceptrons.

use candle_core::{Result, Tensor};

use super::linear::Linear;
use super::ops::Activation;
use super::params::Scope;

/// Affine maps with ReLU between them and nothing after the last.
#[derive(Debug, Clone)]
pub struct Mlp {
    layers: Vec<Linear>,
}

impl Mlp {
    /// A perceptron through widths `dims`, whose tensors are named as in
    /// `torch.nn.Sequential(Linear, ReLU, Linear, ..)`: `0.weight`, `2.weight`, and so on.
    pub fn new(scope: &mut Scope<'_>, name: &str, dims: &[usize]) -> Result<Self> {
        let mut scope = scope.enter(name);
        let layer = |(i, pair): (usize, &[usize])| Linear::new(&mut scope, &(2 * i).to_string(), pair[0], pair[1]);
        Ok(Self { layers: dims.windows(2).enumerate().map(layer).collect::<Result<_>>()? })
    }

    /// (.., first width) to (.., last width).
    ///
    /// # Errors
    /// When the last dimension is not the first width.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.apply(x, None)
    }

    /// As [`forward`](Self::forward) where `valid` (..) is 1, and exactly 0 elsewhere, without work on those rows.
    ///
    /// # Errors
    /// When the last dimension is not the first width or the leading ones are not those of `valid`.
    pub fn forward_valid(&self, x: &Tensor, valid: &Tensor) -> Result<Tensor> {
        self.apply(x, Some(valid))
    }

    fn apply(&self, x: &Tensor, valid: Option<&Tensor>) -> Result<Tensor> {
        let Some((last, before)) = self.layers.split_last() else { return Ok(x.clone()) };
        let hidden = before.iter().try_fold(x.clone(), |x, layer| layer.apply(&x, Activation::Relu, valid))?;
        last.apply(&hidden, Activation::None, valid)
    }
}
