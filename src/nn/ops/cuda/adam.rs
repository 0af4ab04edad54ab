//! The optimizer by kernels: one pass over a parameter.

use candle_core::{Result, Tensor};

use super::launch::Argument::{Count, In, InOut, Number, Out};
use super::launch::{Launch, THREADS, WARP, tensor};
use crate::nn::ops::{AdamStep, Moments};

/// See [`adam_step`](crate::nn::ops::adam_step).
pub(in crate::nn::ops) fn adam_step(
    parameter: &Tensor,
    moments: &Moments,
    grad: &Tensor,
    step: AdamStep,
) -> Result<()> {
    let (n, grad) = (parameter.elem_count(), grad.detach().contiguous()?);
    let AdamStep { grad_scale, beta1, beta2, epsilon, step_size, second_correction } = step;
    let (rest1, rest2) = (1.0 - beta1, 1.0 - beta2);
    let numbers = [grad_scale, beta1, rest1, beta2, rest2, epsilon, step_size, second_correction].map(Number);
    let tensors = [InOut(parameter), InOut(&moments.first), InOut(&moments.second), In(&grad), Count(n)];
    let arguments: Vec<_> = tensors.into_iter().chain(numbers).collect();
    Launch::of_numbers("adam", n, &arguments).run(parameter.device())?;
    Ok(())
}

/// See [`average_step`](crate::nn::ops::average_step).
pub(in crate::nn::ops) fn average_step(average: &Tensor, value: &Tensor, decay: f64) -> Result<()> {
    let (n, value) = (average.elem_count(), value.detach().contiguous()?);
    let arguments = [InOut(average), In(&value), Count(n), Number(decay), Number(1.0 - decay)];
    Launch::of_numbers("average", n, &arguments).run(average.device())?;
    Ok(())
}

/// Sums of the squares of parts of `x`, still on the device.
pub(in crate::nn::ops) fn sums_of_squares(x: &Tensor) -> Result<Tensor> {
    const N_ENTRIES: usize = 1 << 14;
    let (x, n) = (x.detach().contiguous()?, x.elem_count());
    let parts = n.div_ceil(N_ENTRIES);
    let launch = Launch {
        kernel: "sums_of_squares",
        head_dim: 1,
        blocks: (parts, 1),
        threads: THREADS,
        n_shared: THREADS / WARP,
        arguments: &[In(&x), Count(n), Count(N_ENTRIES), Out(parts)],
    };
    Ok(tensor(launch.run_for_one(x.device())?, parts))
}
