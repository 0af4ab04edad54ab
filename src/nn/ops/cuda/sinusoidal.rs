//! Encodings by kernels.

use candle_core::{Result, Tensor};

use super::launch::Argument::{Count, In, Out};
use super::launch::{Launch, tensor};
use super::node::node;

/// See [`sinusoidal`](crate::nn::ops::sinusoidal).
pub(in crate::nn::ops) fn sinusoidal(x: &Tensor, frequencies: &[f64]) -> Result<Tensor> {
    let (n, n_frequencies) = (x.elem_count(), frequencies.len());
    // Two floats together hold 48 bits of each frequency.
    let high: Vec<f32> = frequencies.iter().map(|f| *f as f32).collect();
    let low: Vec<f32> = frequencies.iter().zip(&high).map(|(f, high)| (f - f64::from(*high)) as f32).collect();
    let (high, low) = (Tensor::new(high, x.device())?, Tensor::new(low, x.device())?);
    let numbers = x.detach().contiguous()?;
    let arguments = [In(&numbers), In(&high), In(&low), Count(n), Count(n_frequencies), Out(n * 2 * n_frequencies)];
    let y = Launch::of_numbers("sinusoidal", n * n_frequencies, &arguments).run_for_one(x.device())?;
    let mut shape = x.dims().to_vec();
    shape.push(2 * n_frequencies);
    let x_shape = x.shape().clone();
    node("sinusoidal", &[x], y, shape, move |y, grad, _| {
        let arguments = [In(y), In(grad), In(&high), Count(n), Count(n_frequencies), Out(n)];
        let dx = Launch::of_rows("sinusoidal_backward", n, &arguments).run_for_one(grad.device())?;
        Ok(vec![Some(tensor(dx, &x_shape))])
    })
}
