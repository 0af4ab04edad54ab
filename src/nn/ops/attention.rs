//! Self-attention of states along time or agents.

use std::sync::OnceLock;

use candle_core::{CpuStorage, CustomOp1, D, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::heads::{HeadColumns, add_mixed_back, attend, attend_backward, mix, scatter};
use super::host::{slice, values};
use super::masked_softmax;
use super::rows::{pick_mut, split_mut};
use crate::nn::attention::Axis;

/// The plain implementation: see [`self_attention`](super::self_attention).
pub(super) fn reference(qkv: &Tensor, valid: &Tensor, n_heads: usize, axis: Axis) -> Result<Tensor> {
    let (n_batch, n_agents, n_timesteps, width) = qkv.dims4()?;
    let head_dim = width / (3 * n_heads);
    // (B, A, T, 3, H, d) to (B, A or T, 3 H, T or A, d), and the mask to (B, A or T, T or A).
    let split = qkv.reshape((n_batch, n_agents, n_timesteps, 3 * n_heads, head_dim))?;
    let (split, mask) = match axis {
        Axis::Time => (split.permute((0, 1, 3, 2, 4))?, valid.clone()),
        Axis::Agent => (split.permute((0, 2, 3, 1, 4))?, valid.transpose(1, 2)?),
    };
    // Two dimensions of matrices at most: candle's product takes no more.
    let part = |i: usize| split.narrow(2, i * n_heads, n_heads)?.contiguous()?.flatten(0, 1);
    let (query, key, value) = (part(0)?, part(1)?, part(2)?);
    let scores = (query.matmul(&key.t()?)? * (1.0 / (head_dim as f64).sqrt()))?;
    let weights = masked_softmax(&scores, &mask.flatten(0, 1)?.unsqueeze(1)?.unsqueeze(1)?)?;
    let mixed = weights.matmul(&value)?;
    let mixed = match axis {
        Axis::Time => mixed.reshape((n_batch, n_agents, n_heads, n_timesteps, head_dim))?.permute((0, 1, 3, 2, 4))?,
        Axis::Agent => mixed.reshape((n_batch, n_timesteps, n_heads, n_agents, head_dim))?.permute((0, 3, 1, 2, 4))?,
    };
    let mixed = mixed.reshape((n_batch, n_agents, n_timesteps, width / 3))?;
    mixed.broadcast_mul(&valid.unsqueeze(D::Minus1)?)
}

/// The fused implementation: see [`self_attention`](super::self_attention).
pub(super) fn fused(qkv: &Tensor, valid: &Tensor, n_heads: usize, axis: Axis) -> Result<Tensor> {
    let sequences = Sequences::new(&values(&valid.contiguous()?)?, valid.dims3()?, axis);
    let op = FusedSelfAttention { n_heads, sequences, is_tracked: qkv.track_op(), weights: OnceLock::new() };
    qkv.contiguous()?.apply_op1(op)
}

/// The valid states in groups that attend to each other.
struct Sequences {
    /// Rows of the states, one group after the other.
    rows: Vec<u32>,
    /// Numbers of states of the groups.
    lengths: Vec<usize>,
}

impl Sequences {
    fn new(valid: &[f32], (n_batch, n_agents, n_timesteps): (usize, usize, usize), axis: Axis) -> Self {
        let (mut rows, mut lengths) = (Vec::new(), Vec::new());
        // Entry i of sequence s of a batch row is at s · across + i · along.
        let (n_sequences, across, n, along) = match axis {
            Axis::Time => (n_agents, n_timesteps, n_timesteps, 1),
            Axis::Agent => (n_timesteps, 1, n_agents, n_timesteps),
        };
        for batch in 0..n_batch {
            for sequence in 0..n_sequences {
                let start = batch * n_agents * n_timesteps + sequence * across;
                let before = rows.len();
                rows.extend((0..n).map(|i| start + i * along).filter(|row| valid[*row] != 0.0).map(|row| row as u32));
                if rows.len() > before {
                    lengths.push(rows.len() - before);
                }
            }
        }
        Self { rows, lengths }
    }

    fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let mut rest = self.rows.as_slice();
        self.lengths.iter().map(move |n| {
            let (group, after) = rest.split_at(*n);
            rest = after;
            group
        })
    }
}

/// (B, A, T, 3 D) with queries, keys and values to (B, A, T, D).
struct FusedSelfAttention {
    n_heads: usize,
    sequences: Sequences,
    is_tracked: bool,
    /// The softmax weights of each sequence and head, kept for the backward pass.
    weights: OnceLock<Vec<f32>>,
}

/// Queries, keys and values of one head.
struct Head<'a> {
    query: HeadColumns<'a>,
    key: HeadColumns<'a>,
    value: HeadColumns<'a>,
}

impl FusedSelfAttention {
    fn head<'a>(&self, qkv: &'a [f32], dim: usize, head: usize) -> Head<'a> {
        let n = dim / self.n_heads;
        let part = |part: usize| HeadColumns { data: qkv, width: 3 * dim, first: part * dim + head * n, n };
        Head { query: part(0), key: part(1), value: part(2) }
    }

    /// Numbers of softmax weights of the sequences.
    fn n_weights(&self) -> Vec<usize> {
        self.sequences.lengths.iter().map(|n| self.n_heads * n * n).collect()
    }

    /// One sequence: fills its `weights` and writes its rows of the result.
    fn mix(&self, qkv: &[f32], dim: usize, rows: &[u32], weights: &mut [f32], mixed: &mut [&mut [f32]]) {
        let head_dim = dim / self.n_heads;
        for (i, weights) in weights.chunks_exact_mut(rows.len() * rows.len()).enumerate() {
            let head = self.head(qkv, dim, i);
            let [mut query, mut key, mut value] = [(); 3].map(|()| Vec::new());
            let (query, key) = (head.query.matrix(rows, &mut query), head.key.matrix(rows, &mut key));
            let parts = [query, key, head.value.matrix(rows, &mut value)];
            scatter(mixed, i * head_dim, &attend(weights, rows.len(), head_dim, parts));
        }
    }

    /// One sequence: writes its rows of the gradient at queries, keys and values.
    fn mix_backward(&self, qkv: &[f32], grad: &[f32], rows: &[u32], weights: &[f32], dqkv: &mut [&mut [f32]]) {
        let dim = dqkv[0].len() / 3;
        let head_dim = dim / self.n_heads;
        let mut grad_scores = vec![0.0; rows.len() * rows.len()];
        for (i, weights) in weights.chunks_exact(rows.len() * rows.len()).enumerate() {
            let head = self.head(qkv, dim, i);
            let grad = HeadColumns { data: grad, width: dim, first: i * head_dim, n: head_dim }.gather(rows);
            attend_backward(&mut grad_scores, weights, &head.value.gather(rows), &grad, head_dim);
            scatter(dqkv, head.query.first, &mix(&grad_scores, &head.key.gather(rows), head_dim));
            let (mut dkey, mut dvalue) = (vec![0.0; rows.len() * head_dim], vec![0.0; rows.len() * head_dim]);
            add_mixed_back(&mut dkey, &grad_scores, &head.query.gather(rows), head_dim);
            add_mixed_back(&mut dvalue, weights, &grad, head_dim);
            scatter(dqkv, head.key.first, &dkey);
            scatter(dqkv, head.value.first, &dvalue);
        }
    }
}

impl CustomOp1 for FusedSelfAttention {
    fn name(&self) -> &'static str {
        "self_attention"
    }

    fn cpu_fwd(&self, qkv: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let qkv = slice(qkv, layout)?;
        let (n_batch, n_agents, n_timesteps, width) = layout.shape().dims4()?;
        let dim = width / 3;
        let mut mixed = vec![0.0; n_batch * n_agents * n_timesteps * dim];
        let mut rows = pick_mut(&mut mixed, dim, &self.sequences.rows);
        let n_weights = self.n_weights();
        let mut weights = vec![0.0; n_weights.iter().sum()];
        let tasks: Vec<_> = (self.sequences.iter().zip(split_mut(&mut weights, &n_weights)))
            .zip(split_mut(&mut rows, &self.sequences.lengths))
            .collect();
        tasks.into_par_iter().for_each(|((rows, weights), mixed)| self.mix(qkv, dim, rows, weights, mixed));
        if self.is_tracked && self.weights.set(weights).is_err() {
            bail!("self_attention: an operation is applied once");
        }
        Ok((CpuStorage::F32(mixed), (n_batch, n_agents, n_timesteps, dim).into()))
    }

    fn bwd(&self, qkv: &Tensor, _mixed: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let Some(weights) = self.weights.get() else { bail!("self_attention: no weights were kept") };
        let grad = grad.contiguous()?;
        let mut dqkv = vec![0.0; qkv.elem_count()];
        {
            let (qkv_values, grad) = (values(qkv)?, values(&grad)?);
            let mut rows = pick_mut(&mut dqkv, qkv.dim(D::Minus1)?, &self.sequences.rows);
            let mut weights = weights.as_slice();
            let mut tasks = Vec::with_capacity(self.sequences.lengths.len());
            for ((rows, dqkv), n) in
                self.sequences.iter().zip(split_mut(&mut rows, &self.sequences.lengths)).zip(self.n_weights())
            {
                let (own, rest) = weights.split_at(n);
                weights = rest;
                tasks.push((rows, dqkv, own));
            }
            tasks.into_par_iter().for_each(|(rows, dqkv, weights)| {
                self.mix_backward(&qkv_values, &grad, rows, weights, dqkv);
            });
        }
        Tensor::from_vec(dqkv, qkv.shape(), qkv.device()).map(Some)
    }
}
