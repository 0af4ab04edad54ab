//! Drive into each other.

use super::approach::Approach;
use super::motion::{best_potential, nothing, penalty};
use super::{AgentSelector, SceneContext, SceneObjective, Whose, beyond, one_agent, second};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Touch with a target relative speed (`relative_speed_mps`), 2 to 30 m/s if there is none.
///
/// With s(t) the separation of the boxes (`no_collision`) and ‖u‖ the relative speed that led to timestep t, a moment
/// costs c = ½ (\[s + 0.4 m\]₊ / τ_m)² + ½ (\[‖u‖\] / τ_u)², where \[‖u‖\] is the distance to the target interval. The
/// best moment decides, smoothly: J = -(Σ (c + δ)⁻⁴)^(-1/4) with δ = 0.01.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Collision {
    /// The other of the two.
    #[serde(default = "second")]
    pub to: AgentSelector,
}

/// The error τ_u of the relative speed that costs ½, m/s.
const TOLERANCE_MPS: f64 = 1.0;

/// The remaining gap τ_m that costs ½, meters.
const TOLERANCE_M: f64 = 0.5;

/// The parameter at which it aims, as the events report it.
const RELATIVE_SPEED: &str = "relative_speed_mps";
/// The relative speed without a target, m/s.
const ANY_SPEED_MPS: [f64; 2] = [2.0, 30.0];
/// How much the boxes must overlap, meters; smoothing makes their separation up to 0.2 m less than it is.
const OVERLAP_M: f64 = 0.4;

impl SceneObjective for Collision {
    fn whose(&self) -> Whose {
        Whose::One("first")
    }

    fn others(&self) -> Vec<&AgentSelector> {
        vec![&self.to]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[RELATIVE_SPEED]
    }

    fn validate(&self) -> settings::Result {
        one_agent("to", &self.to)
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let Some((pairs, separation_m, approach)) = Approach::between(states, context, [agents, &self.to])? else {
            return nothing(states);
        };
        let wanted = context.wanted(RELATIVE_SPEED, ANY_SPEED_MPS, states)?;
        let wrong_mps = beyond(&approach.relative_mps, &pairs.of_rows(&wanted)?)?;
        let apart_m = (separation_m.narrow(1, 1, separation_m.dim(1)? - 1)? + OVERLAP_M)?.relu()?;
        let parts = [penalty(&apart_m, TOLERANCE_M)?, penalty(&wrong_mps, TOLERANCE_MPS)?];
        pairs.sum_over_rows(&best_potential(&parts, &approach.counts)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, footprint};
    use super::*;

    fn objective() -> Collision {
        Collision { to: second() }
    }

    fn crossing() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (18.0, -15.0, 1.4, 7.0)])
    }

    #[test]
    fn gradients_match() {
        let crossing = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (18.0, -22.0, 1.4, 7.0)]);
        let behind = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (14.0, 0.3, 0.1, 5.0)]);
        for traffic in [crossing, behind] {
            assert_gradients_match(&objective(), &traffic);
            assert_gradients_match(&objective(), &traffic.aiming_at(RELATIVE_SPEED, [4.0, 5.0]));
        }
    }

    #[test]
    fn they_touch_as_fast_as_is_asked() {
        let states = &after_ascent(&objective(), &crossing().aiming_at(RELATIVE_SPEED, [6.0, 8.0]), 400)[0];
        let footprint = |agent: usize, t: usize| footprint(states, agent, t);
        let relative_mps = |t: usize| {
            let between = |t: usize| footprint(1, t).center - footprint(0, t).center;
            (between(t) - between(t - 1)).norm() / 0.2
        };
        let touching: Vec<f64> =
            (1..states[0].len()).filter(|t| footprint(0, *t).overlaps(&footprint(1, *t))).map(relative_mps).collect();
        assert!(touching.iter().any(|speed_mps| (5.5..8.5).contains(speed_mps)), "{touching:?}");
    }

    #[test]
    fn the_cost_is_that_of_the_distance_and_the_speed() {
        // Side by side with 8 m/s, 1.2 m of separation, or at most 0.2 m less of it: ½ (1.6 / 0.5)² and ½ (2 / 1)².
        let beside = || Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (0.0, 3.0, 0.0, 8.0)]);
        let value = |speeds_mps| -beside().aiming_at(RELATIVE_SPEED, speeds_mps).potential(&objective())[0];
        // Nine moments count as much as one of 9^(-1/4) times the cost.
        let nine = |cost: f64| (cost + 0.01) * 9f64.powf(-0.25);
        let (still, fast) = (value([0.0, 1.0]), value([2.0, 3.0]));
        assert!((nine(0.5 * (1.4f64 / 0.5).powi(2))..nine(0.5 * (1.62f64 / 0.5).powi(2))).contains(&still), "{still}");
        // A norm is rounded at zero: 0.05 m/s per timestep of 0.2 s are 0.25 m/s, or less.
        assert!(fast > still + nine(0.5 * 1.7f64.powi(2)) - nine(0.0) && fast < still + nine(2.0), "{fast} {still}");
    }
}
