//! Attention by kernels.

use candle_core::{Result, Storage, Tensor, bail};

use super::launch::Argument::{Count, In, InOut, Number, Out};
use super::launch::{Argument, Launch, WARP, tensor};
use super::node::node;
use crate::nn::attention::Axis;

/// The most features of a head: beyond them a thread has too few registers for a query.
pub(in crate::nn::ops) const MAX_HEAD_DIM: usize = 64;

/// Rows of keys that a block reads together, TILE in attention.cu.
const TILE: usize = 32;

/// How groups of rows lie in a matrix: row i of group g is (g / inner) · outer + (g mod inner) · between + i · step.
#[derive(Debug, Clone, Copy)]
struct Strides {
    outer: usize,
    between: usize,
    step: usize,
}

/// Which queries attend to which keys, and in which columns they are.
#[derive(Debug, Clone, Copy)]
struct Groups {
    n_groups: usize,
    inner: usize,
    n_queries: usize,
    n_keys: usize,
    queries: Strides,
    keys: Strides,
    n_heads: usize,
    head_dim: usize,
    q_width: usize,
    kv_width: usize,
    key_column: usize,
}

impl Groups {
    /// The features of all heads.
    const fn dim(self) -> usize {
        self.n_heads * self.head_dim
    }

    /// The arguments that all three kernels share.
    fn counts<'a>(self) -> impl Iterator<Item = Argument<'a>> {
        let Self { n_heads, q_width, kv_width, key_column, n_queries, n_keys, inner, queries, keys, .. } = self;
        let strides = [queries.outer, queries.between, queries.step, keys.outer, keys.between, keys.step];
        let scale = 1.0 / (self.head_dim as f64).sqrt();
        [n_heads, q_width, kv_width, key_column, key_column + self.dim(), n_queries, n_keys, inner]
            .into_iter()
            .chain(strides)
            .map(Count)
            .chain([Number(scale)])
    }

    /// A launch with a thread for each head of `n` rows of every group.
    fn launch<'a>(self, kernel: &'static str, n: usize, arguments: &'a [Argument<'a>]) -> Launch<'a> {
        let threads = if n > WARP { 2 * WARP } else { WARP };
        Launch {
            kernel,
            head_dim: self.head_dim,
            blocks: (self.n_groups * self.n_heads, n.div_ceil(threads)),
            threads,
            // Two tiles, and up to three numbers of each of their rows.
            n_shared: TILE * (2 * self.head_dim + 3),
            arguments,
        }
    }
}

/// The tensors of one attention, detached and contiguous.
#[derive(Debug, Clone)]
struct Inputs {
    q: Tensor,
    q_valid: Tensor,
    kv: Tensor,
    k_valid: Tensor,
}

impl Inputs {
    fn first(&self) -> [Argument<'_>; 4] {
        [In(&self.q), In(&self.q_valid), In(&self.kv), In(&self.k_valid)]
    }

    fn n_rows(&self) -> usize {
        self.q_valid.elem_count()
    }
}

/// See [`self_attention`](crate::nn::ops::self_attention).
pub(in crate::nn::ops) fn self_attention(qkv: &Tensor, valid: &Tensor, n_heads: usize, axis: Axis) -> Result<Tensor> {
    let (n_batch, n_agents, n_timesteps, width) = qkv.dims4()?;
    let dim = width / 3;
    let (n_groups, inner, n, strides) = match axis {
        Axis::Time => (n_batch * n_agents, 1, n_timesteps, Strides { outer: n_timesteps, between: 0, step: 1 }),
        Axis::Agent => {
            let strides = Strides { outer: n_agents * n_timesteps, between: 1, step: n_timesteps };
            (n_batch * n_timesteps, n_timesteps, n_agents, strides)
        }
    };
    let groups = Groups {
        n_groups,
        inner,
        n_queries: n,
        n_keys: n,
        queries: strides,
        keys: strides,
        n_heads,
        head_dim: dim / n_heads,
        q_width: width,
        kv_width: width,
        key_column: dim,
    };
    let (rows, valid) = (qkv.detach().contiguous()?, valid.contiguous()?);
    let inputs = Inputs { q: rows.clone(), q_valid: valid.clone(), kv: rows, k_valid: valid };
    let (mixed, log_sums) = forward(groups, &inputs)?;
    let shape = (n_batch, n_agents, n_timesteps, dim);
    node("self_attention", &[qkv], mixed, shape, move |mixed, grad, _| {
        // Queries, keys and values have their gradients in columns of one matrix.
        let dqkv = inputs.q.zeros_like()?;
        let along = at_queries(groups, &inputs, mixed, &log_sums, grad, &dqkv)?;
        at_keys(groups, &inputs, &log_sums, grad, &along, &dqkv)?;
        Ok(vec![Some(dqkv)])
    })
}

/// See [`cross_attention`](crate::nn::ops::cross_attention).
pub(in crate::nn::ops) fn cross_attention(
    query: &Tensor,
    valid: &Tensor,
    keys: &Tensor,
    lane_valid: &Tensor,
    n_heads: usize,
) -> Result<Tensor> {
    let (_, _, _, dim) = query.dims4()?;
    let (n_maps, n_lanes, kv_width) = keys.dims3()?;
    let n_queries = valid.elem_count() / n_maps.max(1);
    let groups = Groups {
        n_groups: n_maps,
        inner: 1,
        n_queries,
        n_keys: n_lanes,
        queries: Strides { outer: n_queries, between: 0, step: 1 },
        keys: Strides { outer: n_lanes, between: 0, step: 1 },
        n_heads,
        head_dim: dim / n_heads,
        q_width: dim,
        kv_width,
        key_column: 0,
    };
    let inputs = Inputs {
        q: query.detach().contiguous()?,
        q_valid: valid.contiguous()?,
        kv: keys.detach().contiguous()?,
        k_valid: lane_valid.contiguous()?,
    };
    let (mixed, log_sums) = forward(groups, &inputs)?;
    node("cross_attention", &[query, keys], mixed, query.shape(), move |mixed, grad, wanted| {
        let dquery = inputs.q.zeros_like()?;
        let along = at_queries(groups, &inputs, mixed, &log_sums, grad, &dquery)?;
        let dkeys = wanted[1].then(|| inputs.kv.zeros_like()).transpose()?;
        if let Some(dkeys) = &dkeys {
            at_keys(groups, &inputs, &log_sums, grad, &along, dkeys)?;
        }
        Ok(vec![Some(dquery), dkeys])
    })
}

/// The mixed values, and the logarithms of the softmax's sums.
fn forward(groups: Groups, inputs: &Inputs) -> Result<(Storage, Tensor)> {
    let (n_rows, n_heads) = (inputs.n_rows(), groups.n_heads);
    let outs = [Out(n_rows * groups.dim()), Out(n_rows * n_heads)];
    let arguments: Vec<_> = inputs.first().into_iter().chain(groups.counts()).chain(outs).collect();
    let written = groups.launch("attention", groups.n_queries, &arguments).run(inputs.q.device())?;
    let Ok([mixed, log_sums]) = <[_; 2]>::try_from(written) else { bail!("attention: two buffers are written") };
    Ok((mixed, tensor(log_sums, (n_rows, n_heads))))
}

/// Writes the gradient at the queries to columns of `to`, whose rows are as wide as theirs, and returns what the
/// gradient at the keys needs.
fn at_queries(
    groups: Groups,
    inputs: &Inputs,
    mixed: &Tensor,
    log_sums: &Tensor,
    grad: &Tensor,
    to: &Tensor,
) -> Result<Tensor> {
    let along = (inputs.n_rows(), groups.n_heads);
    let arguments: Vec<_> = (inputs.first().into_iter())
        .chain([In(mixed), In(log_sums), In(grad)])
        .chain(groups.counts())
        .chain([Count(groups.q_width), InOut(to), Out(along.0 * along.1)])
        .collect();
    let launch = groups.launch("attention_backward_queries", groups.n_queries, &arguments);
    Ok(tensor(launch.run_for_one(grad.device())?, along))
}

/// Writes the gradients at keys and values to columns of `to`.
fn at_keys(
    groups: Groups,
    inputs: &Inputs,
    log_sums: &Tensor,
    grad: &Tensor,
    along: &Tensor,
    to: &Tensor,
) -> Result<()> {
    let arguments: Vec<_> = (inputs.first().into_iter())
        .chain([In(log_sums), In(grad), In(along)])
        .chain(groups.counts())
        .chain([Count(groups.kv_width), InOut(to)])
        .collect();
    groups.launch("attention_backward_keys", groups.n_keys, &arguments).run(grad.device())?;
    Ok(())
}
