//! The pairs of agents for an objective: those near enough to matter, gathered from all rows into one list.

use super::{AgentSelector, SceneContext};
use crate::geometry::Vec2;
use candle_core::{DType, Result, Tensor};

/// P pairs of agents of a batch.
pub(super) struct Pairs {
    pub(super) first: Agents,
    pub(super) second: Agents,
    /// 1 if both states are valid and at least one is generated, (P, T).
    pub(super) counts: Tensor,
    /// 1 if both states are valid, (P, T).
    pub(super) both_valid: Tensor,
    rows: Tensor,
    n_rows: usize,
}

/// One agent of each pair, or of each row.
pub(super) struct Agents {
    /// (P, T, 3).
    pub(super) states: Tensor,
    /// Lengths and widths, (P, 2).
    pub(super) extent_m: Tensor,
    /// 1 if there is a state, (P, T).
    pub(super) valid: Tensor,
    /// 1 if the state is generated, (P, T).
    pub(super) latent: Tensor,
}

impl Agents {
    /// The one agent of each row that `selector` names.
    pub(super) fn named(states: &Tensor, context: &SceneContext, selector: &AgentSelector) -> Result<Self> {
        let (n_rows, n_agents, _, _) = states.dims4()?;
        let slots = context.slots(selector)?.iter().enumerate();
        let flat: Vec<u32> = slots.map(|(row, slot)| (row * n_agents + slot) as u32).collect();
        let flat = Tensor::from_vec(flat, n_rows, states.device())?;
        let of = |tensor: &Tensor| tensor.flatten(0, 1)?.index_select(&flat, 0);
        let (valid, latent) = (of(&context.valid)?, of(&context.latent)?);
        Ok(Self { states: of(states)?, extent_m: of(&context.extent_m)?.to_dtype(states.dtype())?, valid, latent })
    }
}

/// The agents between which pairs are looked for.
pub(super) struct PairQuery<'a> {
    /// The first agent is one of these.
    pub(super) one: &'a AgentSelector,
    /// and the other of these.
    pub(super) other: &'a AgentSelector,
    /// Pairs that are never closer than this do not count: center distance, in sums of the radii around both boxes, and
    /// meters beyond. `None` for all pairs.
    pub(super) reach: Option<Reach>,
    /// A pair to leave out.
    pub(super) except: Option<&'a [AgentSelector; 2]>,
}

impl<'a> PairQuery<'a> {
    /// All pairs of these agents.
    pub(super) const fn of(one: &'a AgentSelector, other: &'a AgentSelector) -> Self {
        Self { one, other, reach: None, except: None }
    }
}

/// A distance, as a multiple of both radii together and meters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub(super) per_radius: f64,
    pub(super) beyond_m: f64,
}

impl Pairs {
    /// The pairs of `query`, without repetitions; `None` if there are none.
    pub(super) fn gather(states: &Tensor, context: &SceneContext, query: &PairQuery<'_>) -> Result<Option<Self>> {
        let (n_rows, n_agents, n_timesteps, _) = states.dims4()?;
        let [first, second, rows] = Self::find(states, context, query)?;
        if rows.is_empty() {
            return Ok(None);
        }
        let n_pairs = rows.len();
        let list = |indices: Vec<u32>| Tensor::from_vec(indices, n_pairs, states.device());
        let (first, second, rows) = (list(first)?, list(second)?, list(rows)?);
        let n_flat = n_rows * n_agents;
        let states = states.reshape((n_flat, n_timesteps, 3))?;
        let valid = context.valid.reshape((n_flat, n_timesteps))?;
        let latent = context.latent.reshape((n_flat, n_timesteps))?;
        let extent_m = context.extent_m.reshape((n_flat, 2))?;
        let agents = |indices: &Tensor| -> Result<Agents> {
            Ok(Agents {
                states: states.index_select(indices, 0)?,
                extent_m: extent_m.index_select(indices, 0)?,
                valid: valid.index_select(indices, 0)?,
                latent: latent.index_select(indices, 0)?,
            })
        };
        let (first, second) = (agents(&first)?, agents(&second)?);
        let both_valid = (&first.valid * &second.valid)?;
        let counts = (&both_valid * first.latent.maximum(&second.latent)?)?;
        Ok(Some(Self { first, second, counts, both_valid, rows, n_rows }))
    }

    /// The first and the second agent of each pair, on the axis of all rows' agents, and its row.
    fn find(states: &Tensor, context: &SceneContext, query: &PairQuery<'_>) -> Result<[Vec<u32>; 3]> {
        let (n_rows, n_agents, n_timesteps, _) = states.dims4()?;
        let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let (at, valid, latent) = (host(states)?, host(&context.valid)?, host(&context.latent)?);
        let extent_m = host(&context.extent_m)?;
        let (one, other) = (host(&context.selected(query.one)?)?, host(&context.selected(query.other)?)?);
        let except = match query.except {
            Some([a, b]) => Some((context.slots(a)?, context.slots(b)?)),
            None => None,
        };
        let is_left_out = |i: usize, j: usize| {
            let (row, pair) = (i / n_agents, [i % n_agents, j % n_agents]);
            except.is_some_and(|(a, b)| pair == [a[row], b[row]] || pair == [b[row], a[row]])
        };
        let is_asked = |i: usize, j: usize| (one[i] * other[j] > 0.0 || one[j] * other[i] > 0.0) && !is_left_out(i, j);
        let radius_m = |i: usize| Vec2::new(extent_m[2 * i], extent_m[2 * i + 1]).norm() / 2.0;
        let is_near = |i: usize, j: usize| {
            let limit = |reach: Reach| reach.per_radius * (radius_m(i) + radius_m(j)) + reach.beyond_m;
            let limit_m = query.reach.map_or(f64::INFINITY, limit);
            (0..n_timesteps).any(|t| {
                let (a, b) = (i * n_timesteps + t, j * n_timesteps + t);
                let counts = valid[a] * valid[b] > 0.0 && latent[a] + latent[b] > 0.0;
                counts && Vec2::new(at[3 * a] - at[3 * b], at[3 * a + 1] - at[3 * b + 1]).norm() <= limit_m
            })
        };
        let mut found: [Vec<u32>; 3] = Default::default();
        for i in 0..n_rows * n_agents {
            let row = i / n_agents;
            for j in (i + 1..(row + 1) * n_agents).filter(|j| is_asked(i, *j) && is_near(i, *j)) {
                found.iter_mut().zip([i, j, row]).for_each(|(list, index)| list.push(index as u32));
            }
        }
        Ok(found)
    }

    /// The rows of `values` (B, ..) that belong to the pairs, (P, ..).
    pub(super) fn of_rows(&self, values: &Tensor) -> Result<Tensor> {
        values.index_select(&self.rows, 0)
    }

    /// Sums over the pairs of each row, (B), of one value a pair, (P).
    pub(super) fn sum_over_rows(&self, values: &Tensor) -> Result<Tensor> {
        Tensor::zeros(self.n_rows, values.dtype(), values.device())?.index_add(&self.rows, values, 0)
    }
}
