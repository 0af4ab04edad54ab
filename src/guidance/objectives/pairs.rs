//! Which pairs of agents does an objective look at? Those near enough to matter, gathered from all rows into one list.

use super::{AgentSelector, SceneContext};
use candle_core::{DType, Result, Tensor};

/// P pairs of agents of a batch.
pub(super) struct Pairs {
    /// States of the first agents, (P, T, 3).
    pub(super) first: Tensor,
    /// States of the second agents, (P, T, 3).
    pub(super) second: Tensor,
    /// Lengths and widths of the first agents, (P, 2).
    pub(super) first_extent_m: Tensor,
    /// Lengths and widths of the second agents, (P, 2).
    pub(super) second_extent_m: Tensor,
    /// 1 where both states are valid and at least one is generated, (P, T).
    pub(super) counts: Tensor,
    /// 1 where both states are valid, (P, T).
    pub(super) both_valid: Tensor,
    rows: Tensor,
    n_rows: usize,
}

/// What pairs are looked for.
pub(super) struct PairQuery<'a> {
    /// One agent is of these,
    pub(super) one: &'a AgentSelector,
    /// and the other of these.
    pub(super) other: &'a AgentSelector,
    /// Pairs that are never nearer than this count nothing: center distance, in sums of the radii around both boxes, and
    /// meters beyond. `None` for all pairs.
    pub(super) reach: Option<Reach>,
}

/// A distance, as a multiple of both radii together and meters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub(super) per_radius: f64,
    pub(super) beyond_m: f64,
}

impl Pairs {
    /// The pairs of `query`, each once; `None` when there are none.
    pub(super) fn gather(states: &Tensor, context: &SceneContext, query: &PairQuery<'_>) -> Result<Option<Self>> {
        let (n_rows, n_agents, n_timesteps, _) = states.dims4()?;
        let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let (at, valid, latent) = (host(states)?, host(&context.valid)?, host(&context.latent)?);
        let extent_m = host(&context.extent_m)?;
        let (one, other) = (host(&context.selected(query.one)?)?, host(&context.selected(query.other)?)?);
        let is_asked = |i: usize, j: usize| one[i] * other[j] > 0.0 || one[j] * other[i] > 0.0;
        let radius_m = |i: usize| extent_m[2 * i].hypot(extent_m[2 * i + 1]) / 2.0;
        let is_near = |i: usize, j: usize| {
            let limit_m = query
                .reach
                .map_or(f64::INFINITY, |reach| reach.per_radius * (radius_m(i) + radius_m(j)) + reach.beyond_m);
            (0..n_timesteps).any(|t| {
                let (a, b) = (i * n_timesteps + t, j * n_timesteps + t);
                let counts = valid[a] * valid[b] > 0.0 && latent[a] + latent[b] > 0.0;
                counts && (at[3 * a] - at[3 * b]).hypot(at[3 * a + 1] - at[3 * b + 1]) <= limit_m
            })
        };
        let (mut first, mut second, mut rows) = (Vec::new(), Vec::new(), Vec::new());
        for row in 0..n_rows {
            for i in row * n_agents..(row + 1) * n_agents {
                for j in i + 1..(row + 1) * n_agents {
                    if is_asked(i, j) && is_near(i, j) {
                        first.push(i as u32);
                        second.push(j as u32);
                        rows.push(row as u32);
                    }
                }
            }
        }
        if rows.is_empty() {
            return Ok(None);
        }
        let n_pairs = rows.len();
        let list = |indices: Vec<u32>| Tensor::from_vec(indices, n_pairs, states.device());
        let (first, second, rows) = (list(first)?, list(second)?, list(rows)?);
        let n_flat = n_rows * n_agents;
        let states = states.reshape((n_flat, n_timesteps, 3))?;
        let valid = context.valid.reshape((n_flat, n_timesteps))?;
        let known = (1.0 - context.latent.reshape((n_flat, n_timesteps))?)?;
        let extent_m = context.extent_m.reshape((n_flat, 2))?;
        let both = |tensor: &Tensor| tensor.index_select(&first, 0)? * tensor.index_select(&second, 0)?;
        let both_valid = both(&valid)?;
        Ok(Some(Self {
            counts: (&both_valid * (1.0 - both(&known)?)?)?,
            both_valid,
            first_extent_m: extent_m.index_select(&first, 0)?,
            second_extent_m: extent_m.index_select(&second, 0)?,
            first: states.index_select(&first, 0)?,
            second: states.index_select(&second, 0)?,
            rows,
            n_rows,
        }))
    }

    /// What belongs to the row of each pair, (P, ..), of `values` (B, ..).
    pub(super) fn of_rows(&self, values: &Tensor) -> Result<Tensor> {
        values.index_select(&self.rows, 0)
    }

    /// Sums over the pairs of each row, (B), of one value a pair, (P).
    pub(super) fn sum_over_rows(&self, values: &Tensor) -> Result<Tensor> {
        Tensor::zeros(self.n_rows, values.dtype(), values.device())?.index_add(&self.rows, values, 0)
    }
}
