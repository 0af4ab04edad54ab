//! Sines and cosines of numbers at many frequencies.

use candle_core::{D, Result, Tensor};

/// The plain implementation: see [`sinusoidal`](super::sinusoidal).
pub(super) fn reference(x: &Tensor, frequencies: &[f64]) -> Result<Tensor> {
    let angular: Vec<f64> = frequencies.iter().map(|f| f * std::f64::consts::TAU).collect();
    let angular = Tensor::new(angular, x.device())?.to_dtype(x.dtype())?;
    let angles = x.unsqueeze(D::Minus1)?.broadcast_mul(&angular)?;
    Tensor::cat(&[angles.sin()?, angles.cos()?], D::Minus1)
}
