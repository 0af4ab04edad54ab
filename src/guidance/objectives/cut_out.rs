//! Leave the lane and reveal a slow vehicle ahead.

use super::chase::{Chase, beyond_times};
use super::lane_change::LaneChange;
use super::motion::{best_potential, nothing, penalty};
use super::one_agent::{OneAgent, SIDE};
use super::pairs::Agents;
use super::{
    AgentSelector, SceneContext, SceneObjective, Side, beyond, default_weight, ego, interval, leader, one_agent,
};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Move over to a lane beside one's own, at a moment when the vehicle behind is on course to reach the one ahead.
///
/// With a(t) how far the leader is beyond the point halfway to the center line of the lane beside it (from where it is at present), g(t) the gap between ego
/// and revealed vehicle, u(t) by how much the ego is faster, v and w their speeds, and T the wanted times to collision, a moment costs
/// c = ½ ((a - 0.3 m) / 0.5 m)² + ½ (\[g - T u\] / τ)² + ½ (\[u\] / 1 m/s)² + ½ (\[w - share v\]₊ / 1 m/s)²,
/// where \[·\] is the distance to what is wanted. The best moment decides, smoothly: J = -(Σ (c + δ)⁻⁴)^(-1/4) with δ = 0.01; to it comes the `lane_change` of the leader, which
/// is beyond the side of the lane at the end. 0 where the map has no lane on the wanted side.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CutOut {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// The agent that leaves the lane: `ego` or a role.
    #[serde(default = "leader")]
    pub agents: AgentSelector,
    /// Who follows: `ego` or a role.
    #[serde(default = "ego")]
    pub before: AgentSelector,
    /// The agent that is revealed: `ego` or a role.
    #[serde(default = "revealed")]
    pub to: AgentSelector,
    /// The side to which it leaves. Left out: that of the target, else the side that costs less.
    #[serde(default)]
    pub side: Option<Side>,
    /// The range of the time to collision at the reveal, seconds. Left out: that of the target (`ttc_s`), else 1 to
    /// 3.5.
    #[serde(default)]
    pub ttc_s: Option<[f64; 2]>,
    /// The range of the speed by which the ego is faster then, m/s. Left out: that of the target
    /// (`relative_speed_mps`), else 2 or more.
    #[serde(default)]
    pub relative_speed_mps: Option<[f64; 2]>,
    /// The highest speed of the revealed vehicle, as a share of the ego's speed.
    #[serde(default = "default_speed_share")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub speed_share: f64,
    /// The error τ of the gap that costs ½, meters.
    #[serde(default = "default_tolerance_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
}

fn revealed() -> AgentSelector {
    AgentSelector::new("revealed")
}

const fn default_speed_share() -> f64 {
    0.45
}

const fn default_tolerance_m() -> f64 {
    2.0
}

/// Parameters at which it aims, as the events report them, beside the side.
const TTC: &str = "ttc_s";
const RELATIVE_SPEED: &str = "relative_speed_mps";
/// The time to collision, seconds, and the relative speed, m/s, without a target.
const ANY_TTC_S: [f64; 2] = [1.0, 3.5];
const ANY_SPEED_MPS: [f64; 2] = [2.0, 1e3];
/// How far the leader's center is beyond the side of the lane at the reveal, meters, and the error that costs ½.
const BEYOND_M: f64 = 0.3;
const ACROSS_TOLERANCE_M: f64 = 0.5;
/// Rounding of the way aside at zero, meters.
const ROUNDING_M: f64 = 0.05;
/// The error of speeds that costs ½, m/s.
const SPEED_TOLERANCE_MPS: f64 = 1.0;
/// How long, seconds, and how near to the center line of the lane beside it, meters, the leader is at the end.
const SETTLED_S: f64 = 0.5;
const SETTLED_M: f64 = 1.2;

impl SceneObjective for CutOut {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.before, &self.to]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[TTC, RELATIVE_SPEED, SIDE]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        one_agent("before", &self.before)?;
        one_agent("to", &self.to)?;
        interval(TTC, self.ttc_s)?;
        interval(RELATIVE_SPEED, self.relative_speed_mps)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let (n_rows, _, n_timesteps, _) = states.dims4()?;
        if n_timesteps < 2 {
            return nothing(states);
        }
        let leader = OneAgent::gather(states, context, &self.agents)?;
        let lines: Vec<_> = (0..n_rows).map(|row| leader.line_beside(context, row, self.side)).collect();
        let frame = leader.across(&lines)?;
        let aside_m = (frame.across_m.sqr()? + ROUNDING_M * ROUNDING_M)?.sqrt()?;
        let halfway_m = (aside_m.narrow(1, context.n_history.saturating_sub(1), 1)? * 0.5)?;
        let moments = |tensor: &Tensor| tensor.narrow(1, 1, n_timesteps - 1);
        let beyond_m = (moments(&aside_m)?.broadcast_sub(&halfway_m)?.neg()? - BEYOND_M)?;

        let [ego, revealed] = [&self.before, &self.to].map(|selector| Agents::named(states, context, selector));
        let chase = Chase::new(&ego?, &revealed?, context)?;
        let closing_mps = (&chase.own_mps - &chase.their_mps)?;
        let wanted_s = context.wanted(TTC, self.ttc_s, ANY_TTC_S, states)?;
        let wanted_mps = context.wanted(RELATIVE_SPEED, self.relative_speed_mps, ANY_SPEED_MPS, states)?;
        let apart_m = beyond_times(&chase.gap_m, &closing_mps, &wanted_s)?;
        let fast_mps = (chase.their_mps - (&chase.own_mps * self.speed_share)?)?.relu()?;
        let parts = [
            penalty(&beyond_m, ACROSS_TOLERANCE_M)?,
            penalty(&apart_m, self.tolerance_m)?,
            penalty(&beyond(&closing_mps, &wanted_mps)?, SPEED_TOLERANCE_MPS)?,
            penalty(&fast_mps, SPEED_TOLERANCE_MPS)?,
        ];
        let best = best_potential(&parts, &(chase.counts * moments(&leader.counts)?)?)?;
        self.leaves().log_potential(states, context)? + (best * frame.has_line)?
    }
}

impl CutOut {
    /// What the leader does at the end.
    fn leaves(&self) -> LaneChange {
        let (agents, side) = (self.agents.clone(), self.side);
        let tolerance_m = ACROSS_TOLERANCE_M;
        LaneChange { weight: 1.0, agents, side, settled_s: SETTLED_S, within_m: SETTLED_M, tolerance_m }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, two_lanes};
    use super::*;

    fn objective(ttc_s: [f64; 2]) -> CutOut {
        let text = "agents = 'leader'\nto = 'revealed'";
        let defaults: CutOut = toml::from_str(text).expect("everything else has a default");
        CutOut { ttc_s: Some(ttc_s), ..defaults }
    }

    /// The ego at 10 m/s behind the leader, and that behind one who stands; a lane lies to their left.
    fn queue() -> Traffic {
        let mut traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 10.0), (14.0, 0.3, 0.0, 10.0), (50.0, 0.0, 0.0, 0.2)]);
        traffic.context.ways = vec![std::sync::Arc::new(two_lanes())];
        traffic.context.roles = [("leader".to_owned(), vec![1]), ("revealed".to_owned(), vec![2])].into();
        traffic
    }

    #[test]
    fn gradients_match() {
        for ttc_s in [[1.0, 1.5], [3.0, 4.0]] {
            assert_gradients_match(&objective(ttc_s), &queue());
        }
    }

    #[test]
    fn following_the_gradient_the_leader_leaves_when_the_ego_is_as_near_as_is_asked() {
        // At constant speeds the time to collision is (45.5 - 1.96 t) / 9.8 seconds: 3.0 at t = 8, 2.6 at t = 10.
        let states = &after_ascent(&objective([2.6, 3.1]), &queue(), 800)[0];
        let is_met = |t: usize| {
            let mps = |who: usize| (states[who][t][0] - states[who][t - 1][0]) / 0.2;
            let ttc_s = (states[2][t][0] - states[0][t][0] - 4.5) / (mps(0) - mps(2));
            (2.5..3.2).contains(&ttc_s) && (1.7..2.7).contains(&states[1][t][1])
        };
        assert!(queue().generated().any(is_met), "{states:?}");
        assert!(states[1][queue().generated().end - 1][1] > 1.9);
    }

    #[test]
    fn without_a_lane_beside_there_is_nothing_to_gain() {
        let mut traffic = queue();
        traffic.context.ways = Traffic::straight(&[(0.0, 0.0, 0.0, 1.0)]).context.ways;
        assert_eq!(traffic.potential(&objective([1.0, 2.0])), [0.0]);
    }

    #[test]
    fn the_cost_is_that_of_what_is_missing_at_the_best_moment() {
        // Nobody leaves: the leader lacks 1.6 + 0.3 m at each of the nine moments, and 3.2 - 1.2 m at the end. At 10 m/s against 0.2 m/s the time to
        // collision sinks from 3.9 to 2.5 s, all of it wanted.
        let value = queue().potential(&objective([0.5, 5.0]))[0];
        let (moments, end) = (0.5 * (1.9f64 / 0.5).powi(2), 0.5 * (2.0f64 / 0.5).powi(2));
        let expected = -(moments + 0.01) / 9f64.powf(0.25) - end;
        assert!((value / expected - 1.0).abs() < 0.01, "{value}, expected {expected}");
    }
}
