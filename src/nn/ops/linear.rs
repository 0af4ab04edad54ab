//! Affine map, bias and activation.

use candle_core::{D, Result, Tensor};

use super::Activation;

/// The plain implementation: see [`linear`](super::linear).
pub(super) fn reference(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    activation: Activation,
    valid: Option<&Tensor>,
) -> Result<Tensor> {
    let (n_out, n_in) = weight.dims2()?;
    let mut shape = x.dims().to_vec();
    shape.pop();
    shape.push(n_out);
    let y = x.reshape(((), n_in))?.matmul(&weight.t()?)?.broadcast_add(bias)?.reshape(shape)?;
    let y = match activation {
        Activation::None => y,
        Activation::Relu => y.relu()?,
    };
    match valid {
        None => Ok(y),
        Some(valid) => y.broadcast_mul(&valid.detach().unsqueeze(D::Minus1)?),
    }
}
