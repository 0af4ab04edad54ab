//! Building blocks of neural networks on candle: layers with seeded parameters, their operations, the optimizer and
//! checkpoints.
//!
//! Tensors carry agents' states as (B, A, T, D): batch, agent, timestep, feature. Masks are (B, A, T) or (B, L) of 0
//! and 1. Layers describe the network once; [`ops`] chooses between the fused and the plain implementations.
//!
//! `in_pool` runs a network on a thread of the pool, and `side_by_side` several; `kernels::vectorized` compiles loops
//! for the processor's widest vector instructions.

mod adam;
mod attention;
mod checkpoint;
mod compute;
mod ema;
mod error;
mod fourier;
mod layer_norm;
mod linear;
mod memory;
mod mlp;
pub mod ops;
mod params;
mod pool;
mod precision;

pub use adam::Adam;
pub use attention::{Axis, CrossAttention, SelfAttention};
pub use checkpoint::{Checkpoint, checksum, parse_checkpoint, read_checkpoint, write_checkpoint};
pub use compute::Compute;
pub use ema::Ema;
pub(crate) use ema::copies;
pub use error::Error;
pub use fourier::sinusoidal;
pub use layer_norm::LayerNorm;
pub use linear::Linear;
pub use memory::keep_freed_memory;
pub use mlp::Mlp;
pub use params::{Init, Params, Scope};
pub use pool::{in_pool, side_by_side};
pub use precision::Precision;

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
