//! Layer normalization by kernels.

use candle_core::{D, Result, Tensor};

use super::launch::Argument::{Count, In, Number, Out};
use super::launch::{Launch, column_sums, tensor};
use super::node::node;

/// See [`layer_norm`](crate::nn::ops::layer_norm).
pub(in crate::nn::ops) fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor, epsilon: f64) -> Result<Tensor> {
    let dim = x.dim(D::Minus1)?;
    let n = x.elem_count() / dim.max(1);
    let (rows, scale) = (x.detach().contiguous()?, weight.detach().contiguous()?);
    let shift = bias.detach().contiguous()?;
    let arguments = [In(&rows), In(&scale), In(&shift), Count(n), Count(dim), Number(epsilon), Out(n * dim)];
    let y = Launch::of_rows("layer_norm", n, &arguments).run_for_one(x.device())?;
    node("layer_norm", &[x, weight, bias], y, x.shape(), move |_, grad, wanted| {
        let arguments =
            [In(&rows), In(&scale), In(grad), Count(n), Count(dim), Number(epsilon), Out(n * dim), Out(n * dim)];
        let mut written = Launch::of_rows("layer_norm_backward", n, &arguments).run(grad.device())?.into_iter();
        let mut next = || written.next().map(|storage| tensor(storage, rows.shape()));
        let (dx, products) = (next(), next());
        let sums = |m: &Tensor, wanted: bool| wanted.then(|| column_sums(m, n, dim)).transpose();
        let dweight = match &products {
            Some(products) => sums(products, wanted[1])?,
            None => None,
        };
        Ok(vec![dx, dweight, sums(grad, wanted[2])?])
    })
}
