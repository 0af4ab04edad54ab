//! Self-attention of states along time or agents.

use candle_core::{D, Result, Tensor};

use super::masked_softmax;
use crate::nn::attention::Axis;

/// The plain implementation: see [`self_attention`](super::self_attention).
pub(super) fn reference(qkv: &Tensor, valid: &Tensor, n_heads: usize, axis: Axis) -> Result<Tensor> {
    let (n_batch, n_agents, n_timesteps, width) = qkv.dims4()?;
    let head_dim = width / (3 * n_heads);
    // (B, A, T, 3, H, d) to (3, B, T or A, H, A or T, d), and the mask to (B, T or A, 1, 1, A or T).
    let split = qkv.reshape((n_batch, n_agents, n_timesteps, 3 * n_heads, head_dim))?;
    let (split, mask) = match axis {
        Axis::Time => (split.permute((0, 1, 3, 2, 4))?, valid.clone()),
        Axis::Agent => (split.permute((0, 2, 3, 1, 4))?, valid.transpose(1, 2)?),
    };
    let part = |i: usize| split.narrow(2, i * n_heads, n_heads)?.contiguous();
    let (query, key, value) = (part(0)?, part(1)?, part(2)?);
    let scores = (query.matmul(&key.t()?)? * (1.0 / (head_dim as f64).sqrt()))?;
    let weights = masked_softmax(&scores, &mask.unsqueeze(2)?.unsqueeze(2)?)?;
    let mixed = weights.matmul(&value)?;
    let mixed = match axis {
        Axis::Time => mixed.permute((0, 1, 3, 2, 4))?,
        Axis::Agent => mixed.permute((0, 3, 1, 2, 4))?,
    };
    let mixed = mixed.reshape((n_batch, n_agents, n_timesteps, width / 3))?;
    mixed.broadcast_mul(&valid.detach().unsqueeze(D::Minus1)?)
}
