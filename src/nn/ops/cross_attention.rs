//! Attention from states to the lanes of their map.

use std::sync::OnceLock;

use candle_core::{CpuStorage, CustomOp2, D, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::gemm::Matrix;
use super::heads::{HeadColumns, add_mixed_back, attend, attend_backward, mix, scatter};
use super::host::{gradient, slice, values};
use super::masked_softmax;
use super::rows::{pick_mut, split, split_mut, valid_rows};

/// States that one task serves.
const N_STATES: usize = 128;

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
    // All states that read one map are its queries, in any row of the batch: (M, H, states, d).
    let heads = query.reshape((n_maps, (), n_heads, head_dim))?.transpose(1, 2)?.contiguous()?;
    let split = keys.reshape((n_maps, n_lanes, 2 * n_heads, head_dim))?.transpose(1, 2)?;
    let (key, value) = (split.narrow(1, 0, n_heads)?.contiguous()?, split.narrow(1, n_heads, n_heads)?.contiguous()?);
    let scores = (heads.matmul(&key.t()?)? * (1.0 / (head_dim as f64).sqrt()))?;
    let weights = masked_softmax(&scores, &lane_valid.unsqueeze(1)?.unsqueeze(1)?)?;
    let mixed = weights.matmul(&value)?.transpose(1, 2)?.reshape(query.shape())?;
    mixed.broadcast_mul(&valid.unsqueeze(D::Minus1)?)
}

/// The fused implementation: see [`cross_attention`](super::cross_attention).
pub(super) fn fused(
    query: &Tensor,
    valid: &Tensor,
    keys: &Tensor,
    lane_valid: &Tensor,
    n_heads: usize,
) -> Result<Tensor> {
    let (n_maps, n_lanes, _) = keys.dims3()?;
    let states = valid_rows(&values(&valid.contiguous()?)?);
    let lanes = valid_rows(&values(&lane_valid.contiguous()?)?);
    let n_states = valid.elem_count() / n_maps;
    let op = FusedCrossAttention {
        n_heads,
        maps: (0..n_maps).map(|map| Map::new(map, &states, n_states, &lanes, n_lanes)).collect(),
        is_tracked: query.track_op() || keys.track_op(),
        weights: OnceLock::new(),
    };
    query.contiguous()?.apply_op2(&keys.contiguous()?, op)
}

/// The valid states that read one map, and its valid lanes.
struct Map {
    states: Vec<u32>,
    lanes: Vec<u32>,
}

impl Map {
    fn new(map: usize, states: &[u32], n_states: usize, lanes: &[u32], n_lanes: usize) -> Self {
        let of_map = |rows: &[u32], n: usize| {
            let start = rows.partition_point(|row| (*row as usize) < map * n);
            let end = rows.partition_point(|row| (*row as usize) < (map + 1) * n);
            rows[start..end].to_vec()
        };
        let lanes = of_map(lanes, n_lanes);
        // Without lanes there is nothing to read, so these states are skipped.
        let states = if lanes.is_empty() { Vec::new() } else { of_map(states, n_states) };
        Self { states, lanes }
    }
}

/// Queries (B, A, T, D), keys and values (M, L, 2 D) to (B, A, T, D).
struct FusedCrossAttention {
    n_heads: usize,
    maps: Vec<Map>,
    is_tracked: bool,
    /// The softmax weights of each task and head, kept for the backward pass.
    weights: OnceLock<Vec<f32>>,
}

/// Some states that read one map.
struct Task<'a> {
    map: usize,
    states: &'a [u32],
}

/// Values of keys or values of one head as one dense matrix, by map and head.
type Packed = Vec<Vec<Vec<f32>>>;

impl FusedCrossAttention {
    /// The work, split alike for any number of threads.
    fn tasks(&self) -> Vec<Task<'_>> {
        let mut tasks = Vec::new();
        for (map, Map { states, .. }) in self.maps.iter().enumerate() {
            tasks.extend(states.chunks(N_STATES).map(|states| Task { map, states }));
        }
        tasks
    }

    fn n_states(tasks: &[Task<'_>]) -> Vec<usize> {
        tasks.iter().map(|task| task.states.len()).collect()
    }

    fn n_weights(&self, tasks: &[Task<'_>]) -> Vec<usize> {
        tasks.iter().map(|task| self.n_heads * task.states.len() * self.maps[task.map].lanes.len()).collect()
    }

    /// Rows of the states that are served, in the order of the tasks.
    fn states(&self) -> Vec<u32> {
        self.maps.iter().flat_map(|map| &map.states).copied().collect()
    }

    /// The columns of one head in a matrix of states (.., D).
    fn head<'a>(&self, data: &'a [f32], dim: usize, head: usize) -> HeadColumns<'a> {
        let n = dim / self.n_heads;
        HeadColumns { data, width: dim, first: head * n, n }
    }

    /// Keys (`part` 0) or values (`part` 1) of the valid lanes.
    fn pack(&self, keys: &[f32], dim: usize, part: usize) -> Packed {
        let n = dim / self.n_heads;
        let columns = |head: usize| HeadColumns { data: keys, width: 2 * dim, first: part * dim + head * n, n };
        let of_map = |map: &Map| (0..self.n_heads).map(|head| columns(head).gather(&map.lanes)).collect();
        self.maps.par_iter().map(of_map).collect()
    }

    /// The gradient at the queries; fills the gradients at the scores.
    fn gradient_of_query(
        &self,
        keys: &[f32],
        dim: usize,
        weights: &[f32],
        grad: &[f32],
        grad_scores: &mut [f32],
    ) -> Vec<f32> {
        let n = dim / self.n_heads;
        let key = self.pack(keys, dim, 0);
        let value = self.pack(keys, dim, 1);
        let tasks = self.tasks();
        let n_weights = self.n_weights(&tasks);
        let mut dquery = vec![0.0; grad.len()];
        let states = self.states();
        let mut rows = pick_mut(&mut dquery, dim, &states);
        let work = tasks.iter().zip(split_mut(&mut rows, &Self::n_states(&tasks)));
        let work = work.zip(split(weights, &n_weights)).zip(split_mut(grad_scores, &n_weights));
        work.collect::<Vec<_>>().into_par_iter().for_each(|(((task, dquery), weights), grad_scores)| {
            let n_weights = weights.len() / self.n_heads;
            let heads = weights.chunks_exact(n_weights).zip(grad_scores.chunks_exact_mut(n_weights));
            for (head, (weights, grad_scores)) in heads.enumerate() {
                let grad = self.head(grad, dim, head).gather(task.states);
                attend_backward(grad_scores, weights, &value[task.map][head], &grad, n);
                scatter(dquery, head * n, &mix(grad_scores, &key[task.map][head], n));
            }
        });
        dquery
    }

    /// The gradient at keys and values (`n_keys` numbers), each map and head summed over its states in their order.
    fn gradient_of_keys(
        &self,
        query: &[f32],
        dim: usize,
        weights: &[f32],
        grad: &[f32],
        grad_scores: &[f32],
        n_keys: usize,
    ) -> Vec<f32> {
        let n = dim / self.n_heads;
        let tasks = self.tasks();
        let n_weights = self.n_weights(&tasks);
        let (weights, grad_scores) = (split(weights, &n_weights), split(grad_scores, &n_weights));
        let of_head = |i: usize| {
            let (map, head) = (i / self.n_heads, i % self.n_heads);
            let n_values = self.maps[map].lanes.len() * n;
            let (mut dkey, mut dvalue) = (vec![0.0; n_values], vec![0.0; n_values]);
            for (t, task) in tasks.iter().enumerate().filter(|(_, task)| task.map == map) {
                let size = weights[t].len() / self.n_heads;
                let own = head * size..(head + 1) * size;
                let query = self.head(query, dim, head).gather(task.states);
                let grad = self.head(grad, dim, head).gather(task.states);
                add_mixed_back(&mut dkey, &grad_scores[t][own.clone()], &query, n);
                add_mixed_back(&mut dvalue, &weights[t][own], &grad, n);
            }
            (dkey, dvalue)
        };
        let heads: Vec<_> = (0..self.maps.len() * self.n_heads).into_par_iter().map(of_head).collect();
        let mut dkeys = vec![0.0; n_keys];
        for (i, (dkey, dvalue)) in heads.iter().enumerate() {
            let mut rows = pick_mut(&mut dkeys, 2 * dim, &self.maps[i / self.n_heads].lanes);
            let first = i % self.n_heads * n;
            scatter(&mut rows, first, dkey);
            scatter(&mut rows, dim + first, dvalue);
        }
        dkeys
    }
}

impl CustomOp2 for FusedCrossAttention {
    fn name(&self) -> &'static str {
        "cross_attention"
    }

    fn cpu_fwd(
        &self,
        query: &CpuStorage,
        query_layout: &Layout,
        keys: &CpuStorage,
        keys_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (query, keys) = (slice(query, query_layout)?, slice(keys, keys_layout)?);
        let dim = query_layout.shape().dims4()?.3;
        let n = dim / self.n_heads;
        let key = self.pack(keys, dim, 0);
        let value = self.pack(keys, dim, 1);
        let tasks = self.tasks();
        let n_weights = self.n_weights(&tasks);
        let (mut mixed, mut weights) = (vec![0.0; query.len()], vec![0.0; n_weights.iter().sum()]);
        let states = self.states();
        let mut rows = pick_mut(&mut mixed, dim, &states);
        let work =
            tasks.iter().zip(split_mut(&mut rows, &Self::n_states(&tasks))).zip(split_mut(&mut weights, &n_weights));
        work.collect::<Vec<_>>().into_par_iter().for_each(|((task, mixed), weights)| {
            let n_weights = weights.len() / self.n_heads;
            for (head, weights) in weights.chunks_exact_mut(n_weights).enumerate() {
                let mut dense = Vec::new();
                let query = self.head(query, dim, head).matrix(task.states, &mut dense);
                let [key, value] = [&key, &value].map(|packed| Matrix::new(&packed[task.map][head], n));
                let n_keys = self.maps[task.map].lanes.len();
                scatter(mixed, head * n, &attend(weights, n_keys, n, [query, key, value]));
            }
        });
        if self.is_tracked && self.weights.set(weights).is_err() {
            bail!("cross_attention: an operation is applied once");
        }
        Ok((CpuStorage::F32(mixed), query_layout.shape().clone()))
    }

    fn bwd(
        &self,
        query: &Tensor,
        keys: &Tensor,
        _mixed: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let Some(weights) = self.weights.get() else { bail!("cross_attention: no weights were kept") };
        let grad = grad.contiguous()?;
        let dim = query.dim(D::Minus1)?;
        let (query_values, keys_values, grad) = (values(query)?, values(keys)?, values(&grad)?);
        let mut grad_scores = vec![0.0; weights.len()];
        let dquery = self.gradient_of_query(&keys_values, dim, weights, &grad, &mut grad_scores);
        let dkeys = keys
            .track_op()
            .then(|| self.gradient_of_keys(&query_values, dim, weights, &grad, &grad_scores, keys.elem_count()));
        let dquery = query.track_op().then_some(dquery);
        Ok((gradient(dquery, query)?, gradient(dkeys, keys)?))
    }
}
