//! Operations on NVIDIA GPUs in `f32`, by kernels of our own.
//!
//! Matrix products are cuBLAS's; the kernels in the `.cu` files do the rest: attention that never stores its weights,
//! layer normalization, steps before and after a product, encodings, the optimizer. NVRTC compiles them for the GPU at
//! hand when the first network runs. All sums have a fixed order, so that the same input gives the same bytes.
//!
//! The Rust side knows tensors and launches, not devices. In tests the same launches run on the host, where an emulator steps
//! through the threads of every block: values, gradients, bounds and barriers are checked on machines without a GPU.

mod adam;
mod attention;
#[cfg(test)]
mod emulator;
#[cfg(feature = "cuda")]
mod gpu;
mod launch;
mod layer_norm;
mod linear;
mod node;
mod sinusoidal;

pub(super) use self::adam::{adam_step, average_step, sums_of_squares};
pub(super) use self::attention::{MAX_HEAD_DIM, cross_attention, self_attention};
pub(super) use self::layer_norm::layer_norm;
pub(super) use self::linear::linear;
pub(super) use self::sinusoidal::sinusoidal;

#[cfg(test)]
pub(crate) use self::emulator::emulate;
#[cfg(test)]
pub(super) use self::emulator::is_emulating;

#[cfg(test)]
mod tests;
