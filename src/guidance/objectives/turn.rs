//! Turn left or right.

use super::motion::{nothing, penalty};
use super::one_agent::OneAgent;
use super::{AgentSelector, SceneContext, SceneObjective, Side, default_weight, one_agent};
use crate::geometry::{Polyline, Vec2, angle_difference};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Take a way that turns, and get through the turn.
///
/// Of the center lines that lead on from the lanes in which the agent is at present, those count that turn by the wanted angle to the wanted
/// side, from their direction where the agent was first seen. Along each, a course r(t) leads from where the agent is at present, at its speed, with
/// a constant acceleration by which it has turned when it is last seen. J = -½ the mean of (max(‖p - r‖ - within, 0) / τ)² over the generated
/// timesteps, for the line of which that is least. 0 where no way turns like that: see `pairs.only_feasible`.
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
    /// How far from the course it may be, meters.
    #[serde(default = "default_within_m")]
    #[schemars(range(min = 0.0, max = 10.0))]
    pub within_m: f64,
    /// The distance τ that costs ½, meters.
    #[serde(default = "default_tolerance_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
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

/// How far beyond the place by which it has turned the agent comes, meters.
const BEYOND_M: f64 = 1.5;
/// How hard it brakes and accelerates on its course at most, m/s².
const ACCELERATIONS_MPS2: [f64; 2] = [-4.0, 2.5];

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
        let courses: Vec<Option<Vec<Vec2>>> = (0..n_rows).map(|row| self.course(&asked, context, row)).collect();
        let away_m = (asked.distance_m(&courses)? - self.within_m)?.relu()?;
        let counted = (penalty(&away_m, self.tolerance_m)? * &asked.counts)?.sum(1)?;
        counted.div(&(asked.counts.sum(1)? + 1e-6)?)
    }
}

impl Turn {
    /// Where the agent is to be at each timestep: on the way that is nearest to where it goes now.
    fn course(&self, asked: &OneAgent, context: &SceneContext, row: usize) -> Option<Vec<Vec2>> {
        let (first, last) = asked.span(row)?;
        let (present, dt_s) = (context.n_history.saturating_sub(1), context.dt_s);
        let now = asked.position(row, present);
        let speed_mps = now.distance(asked.position(row, present.saturating_sub(1).max(first))) / dt_s;
        let horizon_s = last.checked_sub(present).filter(|n| *n > 0)? as f64 * dt_s;
        let courses = context.ways[row].ahead(asked.pose(row)).into_iter().filter_map(|line| {
            let (from, place) = (line.project(asked.position(row, first))?, line.project(now)?);
            let ends_m = self.turned_m(&line, from.station_m, from.heading_rad)? + BEYOND_M - place.station_m;
            let acceleration_mps2 = 2.0 * (ends_m - speed_mps * horizon_s) / horizon_s.powi(2);
            let acceleration_mps2 = acceleration_mps2.clamp(ACCELERATIONS_MPS2[0], ACCELERATIONS_MPS2[1]);
            let at = |timestep: usize| {
                let elapsed_s = timestep.saturating_sub(present) as f64 * dt_s;
                let driven_m = speed_mps * elapsed_s + acceleration_mps2 * elapsed_s.powi(2) / 2.0;
                line.point_at(place.station_m + driven_m.max(0.0))
            };
            (0..=asked.last_timestep()).map(at).collect::<Option<Vec<Vec2>>>()
        });
        let away_m = |course: &Vec<Vec2>| -> f64 {
            (present..=last).map(|timestep| course[timestep].distance(asked.position(row, timestep))).sum()
        };
        courses.min_by(|a, b| away_m(a).total_cmp(&away_m(b)))
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
    use super::super::testing::{Traffic, after_ascent, assert_generated_gradients_match, fork};
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
    fn gradients_match_and_the_car_takes_the_turn() {
        assert_generated_gradients_match(&objective(Side::Left), &traffic());
        let states = &after_ascent(&objective(Side::Left), &traffic(), 100)[0];
        let last = states[0][traffic().generated().end - 1].clone();
        // Turned by 66 degrees or more: at least 9.1 m ahead of where the fork begins and 5.9 m to its left, but for what is free.
        assert!(last[0] > 18.5 && last[0] < 21.0 && last[1] > 5.0, "{last:?}");
    }

    #[test]
    fn where_no_way_turns_there_is_nothing_to_wish() {
        assert_eq!(traffic().potential(&objective(Side::Right)), [0.0]);
        assert!(traffic().potential(&objective(Side::Left))[0] < -1.0);
        assert_eq!(Traffic::straight(&[(0.0, 0.0, 0.0, 8.0)]).potential(&objective(Side::Left)), [0.0]);
    }
}
