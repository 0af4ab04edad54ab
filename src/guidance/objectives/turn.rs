//! Turn left or right.

use super::line_frame::OneAgent;
use super::motion::{nothing, penalty};
use super::{AgentSelector, SceneContext, SceneObjective, Side, default_weight, one_agent};
use crate::geometry::{Polyline, angle_difference};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Take a way that turns, and get through the turn.
///
/// Of the center lines that lead on from the lanes in which the agent is at present, those count that turn by the wanted angle to the wanted
/// side, from their direction where the agent was first seen; s* is the station at which they have. With s and d along and across the line,
///
/// J = -mean of ½ (max(|d| - within, 0) / τ)² over the generated timesteps - ½ (max(s* - s(end), 0) / τ_s)²,
///
/// for the line of which that is least. 0 where no way turns like that: see `pairs.only_feasible`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// How much this objective counts beside others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// Who turns: `ego` or a role.
    #[serde(default = "agent")]
    pub agents: AgentSelector,
    /// To which side.
    pub side: Side,
    /// By how much, at least, radians.
    #[serde(default = "default_angle_rad")]
    #[schemars(range(min = 0.1, max = 6.0))]
    pub angle_rad: f64,
    /// How far from the center line it may be on the way, meters.
    #[serde(default = "default_within_m")]
    #[schemars(range(min = 0.0, max = 10.0))]
    pub within_m: f64,
    /// The error τ of the offset that costs ½, meters.
    #[serde(default = "default_tolerance_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
    /// The way τ_s that lacks at the end and costs ½, meters.
    #[serde(default = "default_along_tolerance_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub along_tolerance_m: f64,
}

fn agent() -> AgentSelector {
    AgentSelector::new("agent")
}

/// 66 degrees: a little more than what counts as a turn.
const fn default_angle_rad() -> f64 {
    1.15
}

const fn default_within_m() -> f64 {
    0.5
}

const fn default_tolerance_m() -> f64 {
    0.5
}

const fn default_along_tolerance_m() -> f64 {
    3.0
}

impl SceneObjective for Turn {
    fn kind(&self) -> &'static str {
        "turn"
    }

    fn weight(&self) -> f64 {
        self.weight
    }

    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let (n_rows, _, n_timesteps, _) = states.dims4()?;
        if n_timesteps <= context.n_history {
            return nothing(states);
        }
        let asked = OneAgent::gather(states, context, &self.agents)?;
        let ways: Vec<Option<TurningWay>> = (0..n_rows).map(|row| self.way(&asked, context, row)).collect();
        let mut is_end = vec![0.0; n_rows * n_timesteps];
        for row in 0..n_rows {
            if let Some((_, last)) = asked.span(row) {
                is_end[row * n_timesteps + last] = 1.0;
            }
        }
        let turned_m: Vec<f64> = ways.iter().map(|way| way.as_ref().map_or(0.0, |way| way.turned_m)).collect();
        let lines: Vec<Option<Polyline>> = ways.into_iter().map(|way| way.map(|way| way.line)).collect();
        let frame = asked.along(&lines)?;
        let constant = |values: Vec<f64>, shape: &[usize]| {
            Tensor::from_vec(values, shape, states.device())?.to_dtype(states.dtype())
        };
        let aside_m = (frame.across_m.abs()? - self.within_m)?.relu()?;
        let on_the_way = (penalty(&aside_m, self.tolerance_m)? * &asked.counts)?.sum(1)?;
        let on_the_way = on_the_way.div(&(asked.counts.sum(1)? + 1e-6)?)?;
        let is_end = (constant(is_end, &[n_rows, n_timesteps])? * &asked.counts)?;
        let end_m = (&frame.along_m * &is_end)?.sum(1)?;
        let lacks_m = ((constant(turned_m, &[n_rows])? - end_m)?.relu()? * is_end.sum(1)?)?;
        (on_the_way + penalty(&lacks_m, self.along_tolerance_m)?)? * frame.has_line
    }
}

/// A line that turns, and the station by which it has.
struct TurningWay {
    line: Polyline,
    turned_m: f64,
}

impl Turn {
    /// The way to take: the one that costs the agent least at its end.
    fn way(&self, asked: &OneAgent, context: &SceneContext, row: usize) -> Option<TurningWay> {
        let (first, last) = asked.span(row)?;
        let (start, end) = (asked.position(row, first), asked.position(row, last));
        let turning = context.ways[row].ahead(asked.pose(row)).into_iter().filter_map(|line| {
            let from = line.project(start)?;
            let turned_m = self.turned_m(&line, from.station_m, from.heading_rad)?;
            Some(TurningWay { line, turned_m })
        });
        let cost = |way: &TurningWay| {
            way.line.project(end).map_or(f64::INFINITY, |place| {
                let lacks_m = (way.turned_m - place.station_m).max(0.0);
                (place.offset_m / self.tolerance_m).powi(2) + (lacks_m / self.along_tolerance_m).powi(2)
            })
        };
        turning.min_by(|a, b| cost(a).total_cmp(&cost(b)))
    }

    /// The station at which `line`, seen from `from_m` on, has turned away from `heading_rad` as far as is wanted.
    fn turned_m(&self, line: &Polyline, from_m: f64, heading_rad: f64) -> Option<f64> {
        let (mut station_m, mut turned_rad, mut before_rad) = (0.0, 0.0, heading_rad);
        for pair in line.0.windows(2) {
            if station_m > from_m {
                let along_rad = (pair[1] - pair[0]).angle();
                turned_rad += self.side.sign() * angle_difference(along_rad, before_rad);
                before_rad = along_rad;
                if turned_rad >= self.angle_rad {
                    return Some(station_m);
                }
            }
            station_m += pair[0].distance(pair[1]);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, fork};
    use super::*;

    fn objective(side: Side) -> Turn {
        let defaults: Turn = toml::from_str("agents = 'ego'\nside = 'left'").expect("everything else has a default");
        Turn { side, ..defaults }
    }

    /// A car on a lane along x that forks after 10 m: straight on, and to the left on a quarter of a circle of 10 m.
    fn traffic() -> Traffic {
        let mut traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0)]);
        traffic.context.ways = vec![std::sync::Arc::new(fork())];
        traffic
    }

    #[test]
    fn gradients_match_where_the_line_is_straight_and_the_car_takes_the_turn() {
        // On a bend, the gradient along the line leaves its curvature out: before it, there is none to leave out.
        let mut before = traffic();
        before.context.ways = vec![std::sync::Arc::new(fork())];
        let slow = Traffic { context: before.context, ..Traffic::straight(&[(0.0, 0.8, 0.0, 3.0)]) };
        assert_gradients_match(&objective(Side::Left), &slow);
        let states = &after_ascent(&objective(Side::Left), &traffic(), 400)[0];
        let last = states[0][traffic().generated().end - 1].clone();
        // Turned by 66 degrees or more: at least 9.1 m ahead of where the fork begins and 5.9 m to its left.
        assert!(last[0] > 18.5 && last[0] < 21.0 && last[1] > 5.0, "{last:?}");
    }

    #[test]
    fn where_no_way_turns_there_is_nothing_to_wish() {
        assert_eq!(traffic().potential(&objective(Side::Right)), [0.0]);
        assert!(traffic().potential(&objective(Side::Left))[0] < -1.0);
        assert_eq!(Traffic::straight(&[(0.0, 0.0, 0.0, 8.0)]).potential(&objective(Side::Left)), [0.0]);
    }
}
