//! One launch of a kernel: its name, threads and arguments.

use candle_core::op::BackpropOp;
use candle_core::{DType, Device, Result, Shape, Storage, Tensor, bail};

/// Threads of a warp.
pub(super) const WARP: usize = 32;
/// The default number of threads of a block.
pub(super) const THREADS: usize = 256;

/// An argument of a kernel, in the order of its declaration.
#[cfg_attr(not(any(test, feature = "cuda")), expect(dead_code, reason = "only GPUs and the emulator look inside"))]
pub(super) enum Argument<'a> {
    /// A contiguous tensor of `f32` that is read.
    In(&'a Tensor),
    /// One of `f32` or `bf16`; the kernel is told which by a flag.
    InEither(&'a Tensor),
    /// One of `f32` that is changed in place.
    InOut(&'a Tensor),
    /// A new buffer of so many numbers. The kernel writes all of them.
    Out(usize),
    /// The same in `bf16`.
    OutHalved(usize),
    /// A count.
    Count(usize),
    /// A number.
    Number(f64),
}

impl Argument<'_> {
    /// A new buffer of so many numbers of `f32`, or of `bf16` where `halved`.
    pub(super) const fn out(len: usize, halved: bool) -> Self {
        if halved { Self::OutHalved(len) } else { Self::Out(len) }
    }

    /// The flag of a kernel: whether numbers have 16 bits.
    pub(super) const fn flag(value: bool) -> Self {
        Self::Count(value as usize)
    }
}

/// Whether the numbers of `x` have 16 bits.
pub(super) fn is_halved(x: &Tensor) -> bool {
    x.dtype() == DType::BF16
}

/// A launch.
#[cfg_attr(not(any(test, feature = "cuda")), expect(dead_code, reason = "only GPUs and the emulator look inside"))]
pub(super) struct Launch<'a> {
    /// The kernel's name.
    pub(super) kernel: &'static str,
    /// Features of an attention head, for kernels compiled for one number of them; any number for others.
    pub(super) head_dim: usize,
    /// Blocks, in two dimensions.
    pub(super) blocks: (usize, usize),
    /// Threads of a block.
    pub(super) threads: usize,
    /// Numbers of shared memory of a block.
    pub(super) n_shared: usize,
    /// The arguments of the kernel.
    pub(super) arguments: &'a [Argument<'a>],
}

impl<'a> Launch<'a> {
    /// One thread for each of `n` numbers.
    pub(super) const fn of_numbers(kernel: &'static str, n: usize, arguments: &'a [Argument<'a>]) -> Self {
        Self { kernel, head_dim: 1, blocks: (n.div_ceil(THREADS), 1), threads: THREADS, n_shared: 0, arguments }
    }

    /// One warp for each of `n` rows.
    pub(super) const fn of_rows(kernel: &'static str, n: usize, arguments: &'a [Argument<'a>]) -> Self {
        Self::of_numbers(kernel, n * WARP, arguments)
    }

    /// Runs the kernel where `device` is and gives the new buffers in their order.
    ///
    /// # Errors
    /// When the device fails, or has no kernels.
    pub(super) fn run(&self, device: &Device) -> Result<Vec<Storage>> {
        match device {
            #[cfg(feature = "cuda")]
            Device::Cuda(device) => super::gpu::run(self, device),
            #[cfg(test)]
            Device::Cpu => super::emulator::run(self),
            _ => bail!("{}: {:?} runs no kernels", self.kernel, device.location()),
        }
    }

    /// As [`run`](Self::run), for a kernel with one new buffer.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub(super) fn run_for_one(&self, device: &Device) -> Result<Storage> {
        match self.run(device)?.pop() {
            Some(storage) => Ok(storage),
            None => bail!("{}: nothing is written", self.kernel),
        }
    }
}

/// A buffer as a tensor without history.
pub(super) fn tensor(storage: Storage, shape: impl Into<Shape>) -> Tensor {
    Tensor::from_storage(storage, shape, BackpropOp::none(), false)
}

/// Sums over the rows of `m` (n, dim), in `f32`: (dim). First of parts of the rows, then of the parts.
///
/// # Errors
/// When the device fails.
pub(super) fn column_sums(m: &Tensor, n: usize, dim: usize) -> Result<Tensor> {
    const N_ROWS: usize = 1024;
    let parts = n.div_ceil(N_ROWS).max(1);
    let n_rows = if parts == 1 { n } else { N_ROWS };
    let launch = Launch {
        kernel: "column_sums",
        head_dim: 1,
        blocks: (parts, dim.div_ceil(WARP)),
        threads: THREADS,
        n_shared: THREADS,
        arguments: &[
            Argument::InEither(m),
            Argument::flag(is_halved(m)),
            Argument::Count(n),
            Argument::Count(dim),
            Argument::Count(n_rows),
            Argument::Out(parts * dim),
        ],
    };
    let sums = tensor(launch.run_for_one(m.device())?, (parts, dim));
    if parts == 1 { sums.flatten_all() } else { column_sums(&sums, parts, dim) }
}
