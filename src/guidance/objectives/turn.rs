//! Turn to the left or right.

use super::motion::penalty;
use super::one_agent::OneAgent;
use super::{
    AgentSelector, SceneContext, SceneObjective, Side, agent, beyond, default_weight, interval, one, one_agent,
};
use crate::guidance::turning_way::{TurningWay, WantedTurn};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Turn to one side along the next lane that turns there, far enough within the scene.
///
/// The way leads on from the agent's own lane and is the one on which the wanted change of heading is nearest; on a scene
/// without lanes it is an arc. With d(t) the offset from its center line, s the agent's last place along it, and v the mean
/// speed in the bend,
///
/// J = -mean of ½ (max(|d| - within, 0) / τ)² - ½ (\[s\] / 2 m)² - ½ (\[v\] / 1 m/s)²
///
/// where \[·\] is the distance to the wanted interval; s is wanted where the way has turned by the wanted change. 0 if no
/// lane turns so: see `pairs.only_feasible`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// The agent that turns: `ego` or a role.
    #[serde(default = "agent")]
    pub agents: AgentSelector,
    /// The side to which it turns.
    pub side: Side,
    /// The range of the change of heading since the agent was first seen, toward that side, radians. Left out: that of
    /// the target (`heading_change_rad`), else 1.2 to 2.6.
    #[serde(default)]
    pub heading_change_rad: Option<[f64; 2]>,
    /// The range of the mean speed in the bend, m/s. Left out: that of the target (`mean_speed_mps`), else any.
    #[serde(default)]
    pub mean_speed_mps: Option<[f64; 2]>,
    /// How far from the center line of the way the agent may be, meters.
    #[serde(default = "one")]
    #[schemars(range(min = 0.0, max = 10.0))]
    pub within_m: f64,
    /// The error τ of the offset that costs ½, meters.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
}

/// The parameters at which it aims, as the events report them.
const HEADING_CHANGE: &str = "heading_change_rad";
const MEAN_SPEED: &str = "mean_speed_mps";
/// The change of heading without a target, radians.
const ANY_CHANGE_RAD: [f64; 2] = [1.2, 2.6];
/// The mean speed without a target, m/s.
const ANY_SPEED_MPS: [f64; 2] = [0.0, 1e3];
/// The errors of the last place and of the speed that cost ½, meters and m/s.
const PLACE_TOLERANCE_M: f64 = 2.0;
const SPEED_TOLERANCE_MPS: f64 = 1.0;

impl SceneObjective for Turn {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[HEADING_CHANGE, MEAN_SPEED]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        interval(HEADING_CHANGE, self.heading_change_rad)?;
        interval(MEAN_SPEED, self.mean_speed_mps)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let asked = OneAgent::gather(states, context, &self.agents)?;
        let n_rows = states.dim(0)?;
        let ways: Vec<Option<TurningWay>> = (0..n_rows).map(|row| self.way(&asked, context, row)).collect();
        let lines: Vec<_> = ways.iter().map(|way| way.as_ref().map(|way| way.line.clone())).collect();
        let frame = asked.across(&lines)?;
        let aside_m = (frame.across_m.abs()? - self.within_m)?.relu()?;
        let n_counted = (asked.counts.sum(1)? + 1e-6)?;
        let aside = ((penalty(&aside_m, self.tolerance_m)? * &asked.counts)?.sum(1)? / n_counted)?;
        let constant = |values: Vec<f64>, shape: (usize, usize)| {
            Tensor::from_vec(values, shape, states.device())?.to_dtype(states.dtype())
        };
        // Rows without a way have no line, and count nothing below.
        let wanted_m = ways.iter().flat_map(|way| way.as_ref().map_or([0.0, f64::MAX], |way| way.wanted_m));
        let wanted_m = constant(wanted_m.map(|m| m.min(1e6)).collect(), (n_rows, 2))?;
        let last = asked.last_counted()?;
        let place_m = (&frame.station_m * &last)?.sum_keepdim(1)?;
        let has_last = last.sum(1)?;
        let place = (penalty(&beyond(&place_m, &wanted_m)?.squeeze(1)?, PLACE_TOLERANCE_M)? * has_last)?;
        let bends: Vec<_> = ways.iter().map(|way| way.as_ref().map(|way| way.bend_m)).collect();
        let (speed_mps, has_speed) = asked.mean_speed(&frame, &bends, context.dt_s)?;
        let wanted_mps = context.wanted(MEAN_SPEED, self.mean_speed_mps, ANY_SPEED_MPS, states)?;
        let speed = (penalty(&beyond(&speed_mps, &wanted_mps)?.squeeze(1)?, SPEED_TOLERANCE_MPS)? * has_speed)?;
        ((aside + place)? + speed)? * frame.has_line
    }
}

impl Turn {
    fn way(&self, asked: &OneAgent, context: &SceneContext, row: usize) -> Option<TurningWay> {
        let sign = self.side.sign();
        let toward = |[least, most]: &[f64; 2]| if sign > 0.0 { [*least, *most] } else { [-most, -least] };
        let target = context.targets[row].get(HEADING_CHANGE).map(toward);
        let change_rad = self.heading_change_rad.or(target).unwrap_or(ANY_CHANGE_RAD);
        let wanted = WantedTurn { sign, change_rad, from_rad: asked.first_heading_rad(row)? };
        let reach_m = asked.present_speed_mps(row, context.dt_s)? * asked.future_s(context.dt_s);
        TurningWay::of(&context.ways[row], asked.pose(row), wanted, reach_m)
    }
}

#[cfg(test)]
#[path = "turn_tests.rs"]
mod tests;
