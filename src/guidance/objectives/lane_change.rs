//! Move over to the lane beside one's own.

use super::motion::{nothing, penalty, unhurried};
use super::one_agent::{OneAgent, SIDE};
use super::{AgentSelector, SceneContext, SceneObjective, Side, Whose};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Be in the lane beside one's own by the end, and stay there.
///
/// With d(t) the offset from the center line of the lane beside the one that the agent is in at present, carried on
/// along its nearest successors, J = -mean of ½ (max(|d| - within, 0) / τ)² over the last 1.1 s, less ½ ∫ (max(|d'| -
/// 1.35 m/s, 0) / 0.1 m/s)² dt: nobody moves over faster than drivers do. If there are several lanes, the one that
/// costs least counts. 0 if the map has no lane on the target side: see `pairs.only_feasible`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LaneChange {
    /// The side to which it changes. Left out: that of the target, else the side that costs less.
    #[serde(default)]
    pub side: Option<Side>,
}

/// How long the agent must be in the new lane at the end, seconds.
const SETTLED_S: f64 = 1.1;

/// How far from the center line of the new lane it may be then, meters.
const WITHIN_M: f64 = 1.2;

/// The largest speed across, m/s.
const MOST_ACROSS_MPS: f64 = 1.35;

/// The error τ of the offset that costs ½, meters.
const TOLERANCE_M: f64 = 0.5;

impl SceneObjective for LaneChange {
    fn whose(&self) -> Whose {
        Whose::One("agent")
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[SIDE]
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let asked = OneAgent::gather(states, context, agents)?;
        let (n_rows, _, n_timesteps, _) = states.dims4()?;
        let n_settled = (SETTLED_S / context.dt_s).round().max(1.0) as usize;
        let n_settled = n_settled.min(n_timesteps.saturating_sub(context.n_history));
        if n_settled == 0 {
            return nothing(states);
        }
        let lines: Vec<_> = (0..n_rows).map(|row| asked.line_beside(context, row, self.side)).collect();
        let frame = asked.across(&lines)?;
        let last = |tensor: &Tensor| tensor.narrow(1, n_timesteps - n_settled, n_settled);
        let aside_m = (last(&frame.across_m)?.abs()? - WITHIN_M)?.relu()?;
        let counts = last(&asked.counts)?;
        let costs = (penalty(&aside_m, TOLERANCE_M)? * &counts)?.sum(1)?.div(&(counts.sum(1)? + 1e-6)?)?;
        (costs + unhurried(&frame.across_m, &asked.counts, MOST_ACROSS_MPS, context.dt_s)?)? * frame.has_line
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, two_lanes};
    use super::*;

    fn objective(side: Option<Side>) -> LaneChange {
        LaneChange { side }
    }

    /// A car in the right one of two lanes along x, whose center lines are at y = 0 and 3.5 m.
    fn traffic() -> Traffic {
        let mut traffic = Traffic::straight(&[(0.0, 0.3, 0.0, 8.0)]);
        traffic.context.ways = vec![std::sync::Arc::new(two_lanes())];
        traffic
    }

    #[test]
    fn gradients_match_and_the_car_ends_in_the_lane_beside() {
        for side in [None, Some(Side::Left)] {
            assert_gradients_match(&objective(side), &traffic());
            let states = &after_ascent(&objective(side), &traffic(), 100)[0];
            let last = traffic().generated().end - 1;
            assert!((states[0][last][1] - 3.5).abs() < 1.5, "{:?}", states[0][last]);
        }
    }

    #[test]
    fn the_cost_is_that_of_the_offset_and_nothing_without_a_lane_there() {
        // 3.2 m from the other center line, 1.2 m of which are free: 2 m are four tolerances.
        let found = traffic().potential(&objective(None))[0];
        assert!((found + 8.0).abs() < 1e-5, "{found}");
        assert_eq!(traffic().potential(&objective(Some(Side::Right))), [0.0]);
        assert_eq!(Traffic::straight(&[(0.0, 0.3, 0.0, 8.0)]).potential(&objective(None)), [0.0]);
        // The target decides if the configuration does not.
        let mut asked = traffic();
        asked.context.targets[0] = [(SIDE.to_owned(), [-1.5, -0.5])].into();
        assert_eq!(asked.potential(&objective(None)), [0.0]);
        assert!(asked.potential(&objective(Some(Side::Left)))[0] < -7.5);
    }
}
