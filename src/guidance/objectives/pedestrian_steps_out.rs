//! Step into the way of a vehicle.

use super::chase::beyond_times;
use super::driven_paths::PathFrame;
use super::motion::{best_potential, penalty};
use super::{AgentSelector, SceneContext, SceneObjective, default_weight, ego, interval, one_agent};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Come within half a lane of the path of `before`, while that one is a wanted time away.
///
/// With d(t) the way beside the path that `before` drives *in the sample*, g(t) the gap along it from its front, v(t) its speed, w half the width of its lane and T the wanted
/// times to arrival, a moment costs c = ½ ((d - w) / 0.3 m)² + ½ (\[g - T v\] / τ)², where \[·\] is by how much the gap is more than the longest and less than the shortest
/// time leaves; another costs e = ½ (\[d - w + 0.5 m\]₊ / 0.3 m)². The best of each decides, smoothly: J = -(Σ (c + δ)⁻⁴)^(-1/4) - (Σ (e + δ)⁻⁴)^(-1/4) with δ = 0.01: at one moment
/// the pedestrian is at the side of the lane, at another inside.
///
/// `before` is taken as it is: nothing pulls at it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PedestrianStepsOut {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// Who steps out: `ego` or a role.
    #[serde(default = "pedestrian")]
    pub agents: AgentSelector,
    /// Whose way it is: `ego` or a role.
    #[serde(default = "ego")]
    pub before: AgentSelector,
    /// The range of the time to arrival, seconds. Left out: that of the target (`time_to_arrival_s`), else 0.8 to 2.6.
    #[serde(default)]
    pub time_to_arrival_s: Option<[f64; 2]>,
    /// Half the width w of the lane, meters.
    #[serde(default = "default_half_width_m")]
    #[schemars(range(min = 0.5, max = 10.0))]
    pub half_width_m: f64,
    /// The error τ of the gap that costs ½, meters.
    #[serde(default = "default_tolerance_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
}

fn pedestrian() -> AgentSelector {
    AgentSelector::new("pedestrian")
}

const fn default_half_width_m() -> f64 {
    1.75
}

const fn default_tolerance_m() -> f64 {
    1.5
}

/// The parameter at which it aims, as the events report it.
const TIME_TO_ARRIVAL: &str = "time_to_arrival_s";
/// The time to arrival without a target, seconds.
const ANY_TIME_S: [f64; 2] = [0.8, 2.6];
/// The error of the way beside the path that costs ½, meters.
const BESIDE_TOLERANCE_M: f64 = 0.3;
/// How far the pedestrian comes into the lane, meters.
const INSIDE_M: f64 = 0.5;

impl SceneObjective for PedestrianStepsOut {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.before]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[TIME_TO_ARRIVAL]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        one_agent("before", &self.before)?;
        interval(TIME_TO_ARRIVAL, self.time_to_arrival_s)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let frame = PathFrame::between(states, context, &self.before, &self.agents)?;
        let wanted_s = context.wanted(TIME_TO_ARRIVAL, self.time_to_arrival_s, ANY_TIME_S, states)?;
        let apart_m = beyond_times(&frame.gap_m, &frame.owner_mps, &wanted_s)?;
        let outside_m = (frame.beside_m - self.half_width_m)?;
        let at_side = [penalty(&outside_m, BESIDE_TOLERANCE_M)?, penalty(&apart_m, self.tolerance_m)?];
        let inside = [penalty(&(outside_m + INSIDE_M)?.relu()?, BESIDE_TOLERANCE_M)?];
        best_potential(&at_side, &frame.counts)? + best_potential(&inside, &frame.counts)?
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_of_match};
    use super::*;

    fn objective(time_to_arrival_s: Option<[f64; 2]>) -> PedestrianStepsOut {
        let defaults: PedestrianStepsOut = toml::from_str("agents = 'other'").expect("everything else has a default");
        PedestrianStepsOut { time_to_arrival_s, ..defaults }
    }

    /// A vehicle at 8 m/s, and somebody who stands beside its lane.
    fn beside() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (25.0, -2.75, 1.5, 0.1)])
    }

    #[test]
    fn gradients_match_for_the_pedestrian_and_nothing_pulls_at_the_vehicle() {
        for wanted in [None, Some([1.0, 1.2])] {
            assert_gradients_of_match(&objective(wanted), &beside(), &[1]);
            let gradient = beside().gradient(&objective(wanted));
            assert!(gradient[..gradient.len() / 2].iter().all(|g| *g == 0.0));
        }
    }

    #[test]
    fn the_cost_is_that_of_the_way_beside_the_lane() {
        // Some 1 m beside the lane at every moment, and 1.5 m from where it is inside; all times are wanted. It moves 0.22 m toward the lane.
        let value = -beside().potential(&objective(Some([0.0, 10.0])))[0];
        let cost = |beside_m: f64| {
            (0.5 * (beside_m / 0.3f64).powi(2) + 0.01, 0.5 * ((beside_m + 0.5) / 0.3f64).powi(2) + 0.01)
        };
        let (near, far) = (cost(0.77), cost(1.0));
        let nine = 9f64.powf(-0.25);
        assert!((nine * (near.0 + near.1)..nine * (far.0 + far.1)).contains(&value), "{value}");
        // Who is 10 m too far away costs more.
        assert!(-beside().potential(&objective(Some([0.0, 0.1])))[0] > value + 1.0);
    }

    #[test]
    fn following_the_gradient_the_pedestrian_is_at_the_side_of_the_lane_in_time_and_then_inside() {
        // The vehicle's front is at 2.25 + 1.6 t meters: 1.4 to 1.0 s away at t = 7 to 9, with half of the pedestrian's length of 4.5 m.
        let states = &after_ascent(&objective(Some([1.0, 1.4])), &beside(), 600)[0];
        let beside_m = |t: usize| states[1][t][1].abs();
        let arrival_s = |t: usize| (states[1][t][0] - states[0][t][0] - 4.5) / 8.0;
        let is_met = |t: usize| (beside_m(t) - 1.75).abs() < 0.2 && (0.9..1.5).contains(&arrival_s(t));
        assert!(beside().generated().any(is_met) && beside().generated().any(|t| beside_m(t) < 1.5), "{:?}", states[1]);
    }
}
