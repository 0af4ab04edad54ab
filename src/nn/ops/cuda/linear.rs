//! Affine map, bias and activation around products of cuBLAS.

use candle_core::{Result, Tensor};

use super::launch::Argument::{Count, In, InEither};
use super::launch::{Argument, Launch, column_sums, is_halved, tensor};
use super::node::node;
use crate::nn::ops::Activation;
use crate::nn::precision::Precision;

/// See [`linear`](crate::nn::ops::linear). Padding is computed like everything else and then set to 0, so it must be
/// finite.
///
/// In `bf16`, factors are rounded once for both passes. `x` may already have 16 bits; rounding it again changes
/// nothing.
pub(in crate::nn::ops) fn linear(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    activation: Activation,
    valid: Option<&Tensor>,
    precision: Precision,
) -> Result<Tensor> {
    let (n_out, n_in) = weight.dims2()?;
    let n = x.elem_count() / n_in.max(1);
    let rows = precision.factor(&x.detach().contiguous()?.reshape((n, n_in))?)?;
    let matrix = precision.factor(&weight.detach())?;
    let product = precision.multiply(&rows, &matrix.t()?)?.contiguous()?;
    let shift = bias.detach().contiguous()?;
    let all_valid = valid.is_none();
    // If all rows are valid, the kernel reads none of these.
    let valid = valid.map_or_else(|| Ok(shift.clone()), Tensor::contiguous)?;
    let relu = activation == Activation::Relu;
    // Only another product reads the output of ReLU.
    let halved = relu && is_halved(&product);
    let counts = move || [Count(n), Count(n_out), Argument::flag(relu), Argument::flag(all_valid)];
    let arguments: Vec<_> = ([InEither(&product), In(&shift), In(&valid)].into_iter())
        .chain(counts())
        .chain([Argument::flag(is_halved(&product)), Argument::flag(halved), Argument::out(n * n_out, halved)])
        .collect();
    let y = Launch::of_numbers("bias_activation", n * n_out, &arguments).run_for_one(x.device())?;
    let mut shape = x.dims()[..x.rank() - 1].to_vec();
    shape.push(n_out);
    let (x_shape, x_dtype, dtype) = (x.shape().clone(), x.dtype(), weight.dtype());
    node("linear", &[x, weight, bias], y, shape, move |y, grad, wanted| {
        let before = if relu || !all_valid {
            let arguments: Vec<_> = ([InEither(y), InEither(grad), In(&valid)].into_iter())
                .chain(counts())
                .chain([Argument::flag(halved), Argument::out(n * n_out, halved)])
                .collect();
            let launch = Launch::of_numbers("bias_activation_backward", n * n_out, &arguments);
            tensor(launch.run_for_one(grad.device())?, (n, n_out))
        } else {
            grad.reshape((n, n_out))?
        };
        let factor = precision.factor(&before)?;
        let at = |i: usize, gradient: &dyn Fn() -> Result<Tensor>| wanted[i].then(gradient).transpose();
        Ok(vec![
            at(0, &|| precision.multiply(&factor, &matrix)?.to_dtype(x_dtype)?.reshape(&x_shape))?,
            at(1, &|| precision.multiply(&factor.t()?, &rows)?.to_dtype(dtype))?,
            at(2, &|| column_sums(&before, n, n_out))?,
        ])
    })
}
