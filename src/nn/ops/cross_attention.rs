//! Attention from states to the lanes of their map.

use candle_core::{D, Result, Tensor};

use super::masked_softmax;

/// The plain implementation: see [`cross_attention`](super::cross_attention).
pub(super) fn reference(
    query: &Tensor,
    valid: &Tensor,
    keys: &Tensor,
    lane_valid: &Tensor,
    n_heads: usize,
) -> Result<Tensor> {
    let (n_maps, n_lanes, width) = keys.dims3()?;
    if n_lanes == 0 {
        return query.zeros_like();
    }
    let head_dim = width / (2 * n_heads);
    // All states that read one map are its queries, whichever row of the batch they are in: (M, H, states, d).
    let heads = query.reshape((n_maps, (), n_heads, head_dim))?.transpose(1, 2)?.contiguous()?;
    let split = keys.reshape((n_maps, n_lanes, 2 * n_heads, head_dim))?.transpose(1, 2)?;
    let (key, value) = (split.narrow(1, 0, n_heads)?.contiguous()?, split.narrow(1, n_heads, n_heads)?.contiguous()?);
    let scores = (heads.matmul(&key.t()?)? * (1.0 / (head_dim as f64).sqrt()))?;
    let weights = masked_softmax(&scores, &lane_valid.unsqueeze(1)?.unsqueeze(1)?)?;
    let mixed = weights.matmul(&value)?.transpose(1, 2)?.reshape(query.shape())?;
    mixed.broadcast_mul(&valid.detach().unsqueeze(D::Minus1)?)
}
