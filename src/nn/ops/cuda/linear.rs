//! Affine map, bias and activation around products of cuBLAS.

use candle_core::{D, Result, Tensor};

use super::launch::Argument::{Count, In, Out};
use super::launch::{Launch, column_sums, tensor};
use super::node::node;
use crate::nn::ops::Activation;
use crate::nn::precision::Precision;

/// See [`linear`](crate::nn::ops::linear). Padding is computed like everything else and only then set to 0, so it has to be finite.
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
    let (rows, matrix) = (x.detach().contiguous()?.reshape((n, n_in))?, weight.detach());
    let product = precision.product(&rows, &matrix.t()?)?.contiguous()?;
    let shift = bias.detach().contiguous()?;
    let all_valid = usize::from(valid.is_none());
    // Where all rows are valid, the kernel looks at none of these.
    let valid = valid.map_or_else(|| Ok(shift.clone()), Tensor::contiguous)?;
    let relu = usize::from(activation == Activation::Relu);
    let counts = move || [Count(n), Count(n_out), Count(relu), Count(all_valid), Out(n * n_out)];
    let arguments: Vec<_> = [In(&product), In(&shift), In(&valid)].into_iter().chain(counts()).collect();
    let y = Launch::of_numbers("bias_activation", n * n_out, &arguments).run_for_one(x.device())?;
    let mut shape = x.dims()[..x.rank() - 1].to_vec();
    shape.push(n_out);
    let x_shape = x.shape().clone();
    node("linear", &[x, weight, bias], y, shape, move |y, grad, wanted| {
        let before = if relu == 0 && all_valid == 1 {
            grad.reshape((n, n_out))?
        } else {
            let arguments: Vec<_> = [In(y), In(grad), In(&valid)].into_iter().chain(counts()).collect();
            let launch = Launch::of_numbers("bias_activation_backward", n * n_out, &arguments);
            tensor(launch.run_for_one(grad.device())?, (n, n_out))
        };
        let at = |i: usize, gradient: &dyn Fn() -> Result<Tensor>| wanted[i].then(gradient).transpose();
        Ok(vec![
            at(0, &|| precision.product(&before, &matrix)?.reshape(&x_shape))?,
            at(1, &|| precision.product(&before.t()?, &rows))?,
            at(2, &|| column_sums(&before, n, before.dim(D::Minus1)?))?,
        ])
    })
}
