//! The speed of two agents relative to each other.

use super::box_separation::separation_m;
use super::motion::{norm, positions};
use super::pairs::{PairQuery, Pairs};
use super::{AgentSelector, SceneContext};
use candle_core::{Result, Tensor};

/// Pairs at the timesteps from the second on, with the velocity that led there: (P, T - 1) each.
pub(super) struct Approach {
    /// The relative speed, m/s.
    pub(super) relative_mps: Tensor,
    /// 1 if both timesteps have states of both agents, one of which is generated.
    pub(super) counts: Tensor,
}

impl Approach {
    /// The approach of the pair of `one` and `other` in each row, with the pairs and the separation of their boxes, (P,
    /// T). `None` if there is no such pair, or only one timestep.
    pub(super) fn between(
        states: &Tensor,
        context: &SceneContext,
        [one, other]: [&AgentSelector; 2],
    ) -> Result<Option<(Pairs, Tensor, Self)>> {
        let query = PairQuery::of(one, other);
        let Some(pairs) = Pairs::gather(states, context, &query)?.filter(|_| states.dim(2).is_ok_and(|n| n > 1)) else {
            return Ok(None);
        };
        let separation_m = separation_m(&pairs)?;
        let approach = Self::new(&pairs, context.dt_s)?;
        Ok(Some((pairs, separation_m, approach)))
    }

    /// The approach of `pairs`, at two or more timesteps.
    fn new(pairs: &Pairs, dt_s: f64) -> Result<Self> {
        let between = (positions(&pairs.second.states)? - positions(&pairs.first.states)?)?;
        let n_steps = between.dim(1)? - 1;
        let (earlier, later) =
            (|tensor: &Tensor| tensor.narrow(1, 0, n_steps), |tensor: &Tensor| tensor.narrow(1, 1, n_steps));
        let relative = ((later(&between)? - earlier(&between)?)? * (1.0 / dt_s))?;
        Ok(Self {
            relative_mps: norm(&relative)?,
            counts: ((later(&pairs.counts)? + earlier(&pairs.counts)?)?.minimum(1.0)?
                * (later(&pairs.both_valid)? * earlier(&pairs.both_valid)?)?)?,
        })
    }
}
