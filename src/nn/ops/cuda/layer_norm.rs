//! Layer normalization by kernels.

use candle_core::{D, Result, Tensor};

use super::launch::Argument::{Count, In, InEither, Number, Out};
use super::launch::{Argument, Launch, column_sums, tensor};
use super::node::node;
use crate::nn::precision::Precision;

/// See [`layer_norm`](crate::nn::ops::layer_norm).
pub(in crate::nn::ops) fn layer_norm(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    epsilon: f64,
    kept: Precision,
) -> Result<Tensor> {
    let dim = x.dim(D::Minus1)?;
    let n = x.elem_count() / dim.max(1);
    let (rows, scale) = (x.detach().contiguous()?, weight.detach().contiguous()?);
    let shift = bias.detach().contiguous()?;
    let halved = kept == Precision::Bf16;
    let counts = move || [Count(n), Count(dim), Number(epsilon), Argument::flag(halved)];
    let written = [Argument::out(n * dim, halved)];
    let arguments: Vec<_> = [In(&rows), In(&scale), In(&shift)].into_iter().chain(counts()).chain(written).collect();
    let y = Launch::of_rows("layer_norm", n, &arguments).run_for_one(x.device())?;
    node("layer_norm", &[x, weight, bias], y, x.shape(), move |_, grad, wanted| {
        let written = [Out(n * dim), Out(n * dim)];
        let arguments: Vec<_> =
            [In(&rows), In(&scale), InEither(grad)].into_iter().chain(counts()).chain(written).collect();
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
