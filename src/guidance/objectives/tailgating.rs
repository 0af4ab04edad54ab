//! Drive too close behind another.

use super::chase::{Chase, beyond_times};
use super::motion::{best_potential, nothing, penalty};
use super::pairs::Agents;
use super::{AgentSelector, SceneContext, SceneObjective, beyond, default_weight, interval, leader, one, one_agent};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Keep a wanted time headway behind `to` for some time, fast enough.
///
/// With g(t) the gap, v(t) the speed of the follower and h the wanted headways, a timestep costs
/// ½ (\[g - h v\] / τ)² + ½ (\[v\] / 1 m/s)², where \[·\] is by how much the gap is more than the longest and less than the shortest wanted headway leaves at this speed, and the
/// distance to the wanted speeds. A stretch of `duration_s` costs the mean c of its timesteps, and the best stretch decides, smoothly:
/// J = -(Σ (c + δ)⁻⁴)^(-1/4) with δ = 0.01.
///
/// `to` is taken as it is: nothing pulls at it, lest it brake instead. 0 where the scene is shorter than a stretch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tailgating {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// Who drives too close: `ego` or a role.
    #[serde(default = "follower")]
    pub agents: AgentSelector,
    /// Who is ahead of it: `ego` or a role.
    #[serde(default = "leader")]
    pub to: AgentSelector,
    /// The range of the time headway, seconds. Left out: that of the target (`time_headway_s`), else 0.4 to 0.8.
    #[serde(default)]
    pub headway_s: Option<[f64; 2]>,
    /// The range of the follower's speed, m/s. Left out: that of the target (`mean_speed_mps`), else 8.5 or more.
    #[serde(default)]
    pub speed_mps: Option<[f64; 2]>,
    /// How long a stretch is, seconds.
    #[serde(default = "default_duration_s")]
    #[schemars(range(min = 0.0, max = 100.0))]
    pub duration_s: f64,
    /// The error τ of the gap that costs ½, meters.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
}

fn follower() -> AgentSelector {
    AgentSelector::new("follower")
}

const fn default_duration_s() -> f64 {
    2.2
}

/// The parameters at which it aims, as the events report them.
const HEADWAY: &str = "time_headway_s";
const SPEED: &str = "mean_speed_mps";
/// The headway, seconds, and the speed, m/s, without a target.
const ANY_HEADWAY_S: [f64; 2] = [0.4, 0.8];
const ANY_SPEED_MPS: [f64; 2] = [8.5, 1e3];
/// The error of the speed that costs ½, m/s.
const SPEED_TOLERANCE_MPS: f64 = 1.0;

impl SceneObjective for Tailgating {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.to]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[HEADWAY, SPEED]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        one_agent("to", &self.to)?;
        interval("headway_s", self.headway_s)?;
        interval("speed_mps", self.speed_mps)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let n_stretch = (self.duration_s / context.dt_s).round() as usize + 1;
        // Speeds lie between timesteps: there is one less.
        let Some(n_stretches) = states.dim(2)?.checked_sub(n_stretch).filter(|n| *n > 0) else {
            return nothing(states);
        };
        let follower = Agents::named(states, context, &self.agents)?;
        let chase = Chase::new(&follower, &Agents::named(states, context, &self.to)?.held(), context)?;
        let wanted_s = context.wanted(HEADWAY, self.headway_s, ANY_HEADWAY_S, states)?;
        let wanted_mps = context.wanted(SPEED, self.speed_mps, ANY_SPEED_MPS, states)?;
        let apart_m = beyond_times(&chase.gap_m, &chase.own_mps, &wanted_s)?;
        let slow_mps = beyond(&chase.own_mps, &wanted_mps)?;
        let potential = (penalty(&apart_m, self.tolerance_m)? + penalty(&slow_mps, SPEED_TOLERANCE_MPS)?)?;
        // Stretches by their first timestep, (B, N, timesteps of one).
        let stretches = |values: &Tensor| {
            let of = (0..n_stretch).map(|step| values.narrow(1, step, n_stretches)).collect::<Result<Vec<_>>>()?;
            Tensor::stack(&of, 2)
        };
        // Whole stretches that hold a generated state.
        let counts = (stretches(&chase.valid)?.min(2)? * stretches(&chase.counts)?.max(2)?)?;
        best_potential(&[stretches(&potential)?.mean(2)?], &counts)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_of_match};
    use super::*;

    fn objective(headway_s: Option<[f64; 2]>) -> Tailgating {
        let text = "agents = 'ego'\nto = 'other'\nduration_s = 1.0";
        let defaults: Tailgating = toml::from_str(text).expect("everything else has a default");
        Tailgating { headway_s, ..defaults }
    }

    /// Both at 10 m/s, with a gap of 15 m.
    fn far_behind() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 10.0), (19.5, 0.0, 0.0, 10.0)])
    }

    #[test]
    fn gradients_match_for_the_follower_and_nothing_pulls_at_the_leader() {
        let slow = Traffic::straight(&[(0.0, 0.0, 0.1, 6.0), (16.0, 1.0, 0.0, 9.0)]);
        for traffic in [far_behind(), slow] {
            assert_gradients_of_match(&objective(None), &traffic, &[0]);
            assert_gradients_of_match(&objective(Some([0.5, 0.6])), &traffic, &[0]);
            let gradient = traffic.gradient(&objective(None));
            assert!(gradient[gradient.len() / 2..].iter().all(|g| *g == 0.0));
        }
    }

    #[test]
    fn the_cost_is_that_of_the_gap_beyond_the_headway() {
        // 15 m of gap where 0.8 s leave 8 m: 7 m too much at each moment of every stretch of six. Of eleven moments all but the
        // first two stretches, which are observed, hold a generated one: six in all.
        let value = far_behind().potential(&objective(Some([0.4, 0.8])))[0];
        let expected = -(0.5 * 49.0 + 0.01) / 6f64.powf(0.25);
        assert!((value / expected - 1.0).abs() < 0.01, "{value}, expected {expected}");
        let mut asked = far_behind();
        asked.context.targets[0] = [(HEADWAY.to_owned(), [1.4, 1.6]), (SPEED.to_owned(), [9.0, 11.0])].into();
        assert!(asked.potential(&objective(None))[0] > -0.01);
        asked.context.targets[0] = [(HEADWAY.to_owned(), [1.4, 1.6]), (SPEED.to_owned(), [12.0, 13.0])].into();
        assert!((asked.potential(&objective(None))[0] + 2.01 / 6f64.powf(0.25)).abs() < 0.02);
    }

    #[test]
    fn following_the_gradient_closes_up() {
        let states = &after_ascent(&objective(Some([0.5, 0.6])), &far_behind(), 500)[0];
        let headway_s = |t: usize| {
            let speed_mps = (states[0][t][0] - states[0][t - 1][0]) / 0.2;
            (states[1][t][0] - states[0][t][0] - 4.5) / speed_mps
        };
        let near = far_behind().generated().filter(|t| (0.4..0.7).contains(&headway_s(*t))).count();
        assert!(near >= 6, "{states:?}");
    }
}
