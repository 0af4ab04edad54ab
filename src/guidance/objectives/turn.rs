//! Turn to the left or right.

use super::motion::{norm, penalty};
use super::one_agent::OneAgent;
use super::{AgentSelector, SceneContext, SceneObjective, Side, Whose};
use crate::geometry::Vec2;
use crate::guidance::turning_way::{TurningWay, WantedTurn};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Turn to one side along the next lane that turns there, far enough within the scene.
///
/// The way leads on from the agent's own lane and is the one on which the target change of heading is nearest; on a
/// scene without lanes it is an arc. Without a target, the heading changes by 1.2 to 2.6 rad, at any speed. Its station
/// s(t) is where the agent would be on it with the lengths of its own steps, if they had the target mean speed in the
/// bend and ended where the way has turned by the target change. With d(t) the distance from there, and θ(t) the angle
/// from the heading of the way there,
///
/// J = -mean of ½ (max(d - within, 0) / τ)² + (1 - cos θ) / (0.3 rad)²
///
/// over the generated future. Stations are held: a gradient through them, or the nearest point of the way, would let an
/// agent pay less by stopping ahead of the bend. Headings count where they are generated. 0 if no lane turns so: see
/// `pairs.only_feasible`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// The side to which it turns.
    pub side: Side,
}

/// How far from its place on the way the agent may be, meters.
const WITHIN_M: f64 = 1.0;

/// The error τ of the distance that costs ½, meters.
const TOLERANCE_M: f64 = 1.0;

/// The parameters at which it aims, as the events report them.
const HEADING_CHANGE: &str = "heading_change_rad";
const MEAN_SPEED: &str = "mean_speed_mps";
/// The change of heading without a target, radians.
const ANY_CHANGE_RAD: [f64; 2] = [1.2, 2.6];
/// The mean speed without a target, m/s.
const ANY_SPEED_MPS: [f64; 2] = [0.0, 1e3];
/// The error of the heading that costs ½, radians.
const HEADING_TOLERANCE_RAD: f64 = 0.3;

impl SceneObjective for Turn {
    fn whose(&self) -> Whose {
        Whose::One("agent")
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[HEADING_CHANGE, MEAN_SPEED]
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let asked = OneAgent::gather(states, context, agents)?;
        let (n_rows, n_ahead) = (states.dim(0)?, asked.future().len());
        let (mut points, mut headings, mut is_asked) = (Vec::new(), Vec::new(), Vec::new());
        for row in 0..n_rows {
            let wanted = self.wanted(&asked, context, row);
            is_asked.push(f64::from(u8::from(wanted.is_some())));
            for (point, heading_rad) in wanted.unwrap_or_else(|| vec![(Vec2::ZERO, 0.0); n_ahead]) {
                points.extend([point.x, point.y]);
                headings.push(heading_rad);
            }
        }
        let constant = |values: Vec<f64>| Tensor::new(values, states.device())?.to_dtype(states.dtype());
        let (places, own_headings, counts) = asked.futures()?;
        let aside_m = norm(&(places - constant(points)?.reshape((n_rows, n_ahead, 2))?)?)?;
        let mut costs = penalty(&(aside_m - WITHIN_M)?.relu()?, TOLERANCE_M)?;
        if context.generates_headings {
            let off = (own_headings - constant(headings)?.reshape((n_rows, n_ahead))?)?;
            costs = (costs + ((off.cos()? - 1.0)? * HEADING_TOLERANCE_RAD.powi(-2))?)?;
        }
        ((costs * &counts)?.sum(1)? / (counts.sum(1)? + 1e-6)?)? * constant(is_asked)?
    }
}

impl Turn {
    /// The place of the agent of a row at each timestep after the present by its target, and its heading there; `None`
    /// if no lane turns in this way.
    fn wanted(&self, asked: &OneAgent, context: &SceneContext, row: usize) -> Option<Vec<(Vec2, f64)>> {
        let way = self.way(asked, context, row)?;
        let speed_mps = context.targets[row].get(MEAN_SPEED).copied().unwrap_or(ANY_SPEED_MPS);
        let stations_m = way.stations_m(&asked.steps_m(row), speed_mps.map(|mps| mps * context.dt_s));
        Some(stations_m.into_iter().map(|station_m| way.at(station_m)).collect())
    }

    fn way(&self, asked: &OneAgent, context: &SceneContext, row: usize) -> Option<TurningWay> {
        let sign = self.side.sign();
        let toward = |[least, most]: &[f64; 2]| if sign > 0.0 { [*least, *most] } else { [-most, -least] };
        let change_rad = context.targets[row].get(HEADING_CHANGE).map_or(ANY_CHANGE_RAD, toward);
        let wanted = WantedTurn { sign, change_rad, from_rad: asked.first_heading_rad(row)? };
        let reach_m = asked.present_speed_mps(row, context.dt_s)? * asked.future().len() as f64 * context.dt_s;
        TurningWay::of(&context.ways[row], asked.pose(row), wanted, reach_m)
    }
}

#[cfg(test)]
#[path = "turn_tests.rs"]
mod tests;
