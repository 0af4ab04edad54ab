//! Drive in the oncoming lane.

use super::lane_change::settled;
use super::one_agent::OneAgent;
use super::{AgentSelector, SceneContext, SceneObjective, Whose};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Be in the oncoming lane beside one's own by the end, and stay there.
///
/// The cost is that of `lane_change`: with d(t) the offset from the center line of the lane that comes toward the agent
/// beside its place at present, carried on to where that lane comes from, J = -mean of ½ (max(|d| - within, 0) / τ)²
/// over the last 1.7 s. If there are several such lanes, the nearest one counts; 0 if there is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WrongWay {}

/// How long the agent must be in the oncoming lane at the end, seconds.
const AGAINST_S: f64 = 1.7;

/// How far from the center line of that lane it may be at the end, meters.
const WITHIN_M: f64 = 1.2;

/// The error τ of the offset that costs ½, meters.
const TOLERANCE_M: f64 = 0.5;

impl SceneObjective for WrongWay {
    fn whose(&self) -> Whose {
        Whose::One("agent")
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let asked = OneAgent::gather(states, context, agents)?;
        let line = |row: usize| asked.oncoming_line(context, row);
        settled(states, context, &asked, line, [AGAINST_S, WITHIN_M, TOLERANCE_M, f64::INFINITY])
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, two_lanes, two_way_street};
    use super::*;

    fn objective() -> WrongWay {
        WrongWay {}
    }

    fn traffic() -> Traffic {
        let mut traffic = Traffic::straight(&[(0.0, 0.3, 0.0, 8.0)]);
        traffic.context.ways = vec![std::sync::Arc::new(two_way_street())];
        traffic
    }

    #[test]
    fn the_cost_is_that_of_the_way_to_the_oncoming_lane() {
        // 3.2 m aside, 1.2 m of which are free: ½ (2 / 0.5)².
        assert!((traffic().potential(&objective())[0] + 8.0).abs() < 1e-5);
        assert_gradients_match(&objective(), &traffic());
    }

    #[test]
    fn following_the_gradient_the_car_ends_in_the_oncoming_lane() {
        let states = &after_ascent(&objective(), &traffic(), 100)[0];
        let last = traffic().generated().end - 1;
        assert!((last - 3..=last).all(|t| (states[0][t][1] - 3.5).abs() < 1.25), "{states:?}");
    }

    #[test]
    fn without_an_oncoming_lane_there_is_nothing_to_gain() {
        let mut traffic = traffic();
        traffic.context.ways = vec![std::sync::Arc::new(two_lanes())];
        assert_eq!(traffic.potential(&objective()), [0.0]);
    }
}
