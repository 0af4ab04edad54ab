//! Keep the heading along the motion.

use super::motion::{headings, integral, norm, nothing, penalty, positions, rate};
use super::{AgentSelector, SceneContext, SceneObjective};
use candle_core::{D, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Point where you drive: J = -½ Σ ∫ (max(|v⊥(t)| - ‖v(t)‖ sin β - |ω(t)| L / 2, 0) / τ)² dt over the chosen motorized
/// agents.
///
/// The center of a vehicle of length L that turns at a rate ω about an axle between its middle and its end moves aside
/// by up to |ω| L / 2; that allowance has no gradient, so that nobody turns to slide. v is the difference quotient of
/// positions and v⊥ its part across the mean heading of both timesteps; ‖v‖ is rounded by 0.05 m/s at zero. Agents that
/// are not motorized do not count: they step aside. The potential is 0 where headings follow the motion anyway.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SlipLimit {
    /// The largest angle β between heading and motion, radians.
    #[serde(default = "default_limit_rad")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub limit_rad: f64,
}

/// The excess of sideways speed τ that costs ½ a second, m/s.
const TOLERANCE_MPS: f64 = 0.5;

const fn default_limit_rad() -> f64 {
    0.2
}

impl SceneObjective for SlipLimit {
    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        if !context.generates_headings {
            return nothing(states);
        }
        let velocity_mps = rate(&positions(states)?, context.dt_s)?;
        let n = velocity_mps.dim(2)?;
        // The direction halfway between two headings, without a choice of turns.
        let halfway = |of: Tensor| of.narrow(2, 0, n)? + of.narrow(2, 1, n)?;
        let (cos_of_each, sin_of_each) = (headings(states)?.cos()?, headings(states)?.sin()?);
        let turn = ((cos_of_each.narrow(2, 0, n)? * sin_of_each.narrow(2, 1, n)?)?
            - (sin_of_each.narrow(2, 0, n)? * cos_of_each.narrow(2, 1, n)?)?)?;
        let half_length_m = (context.extent_m.narrow(2, 0, 1)? / 2.0)?;
        let turning_mps = (turn.squeeze(D::Minus1)?.abs()?.detach() / context.dt_s)?.broadcast_mul(&half_length_m)?;
        let (cos, sin) = (halfway(cos_of_each)?, halfway(sin_of_each)?);
        let length = norm(&Tensor::cat(&[&cos, &sin], 3)?)?.unsqueeze(3)?;
        let velocity = |dim: usize| velocity_mps.narrow(D::Minus1, dim, 1);
        let across = ((velocity(1)? * cos)? - (velocity(0)? * sin)?)?.div(&length)?;
        let allowed_mps = ((norm(&velocity_mps)? * self.limit_rad.sin())? + turning_mps)?;
        let values = penalty(&(across.squeeze(D::Minus1)?.abs()? - allowed_mps)?.relu()?, TOLERANCE_MPS)?;
        let agents = (context.selected(agents)? * &context.motorized)?;
        integral(&values, &context.terms(1)?, &agents, context.dt_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match};
    use super::*;
    use candle_core::Var;

    fn objective() -> SlipLimit {
        SlipLimit { limit_rad: 0.1 }
    }

    /// One car at 10 m/s along x whose heading is `heading_rad` throughout.
    fn turned(heading_rad: f64) -> Traffic {
        let mut traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 10.0)]);
        let mut states: Vec<f64> = traffic.states.flatten_all().unwrap().to_vec1().unwrap();
        states.iter_mut().skip(2).step_by(3).for_each(|heading| *heading = heading_rad);
        let states = Tensor::from_vec(states, traffic.states.shape(), traffic.states.device()).unwrap();
        traffic.states = Var::from_tensor(&states).unwrap();
        traffic
    }

    #[test]
    fn the_cost_is_that_of_the_sideways_speed() {
        let traffic = turned(0.3);
        // One step from the last observed state on: as many as generated timesteps.
        let seconds = traffic.n_generated() as f64 * traffic.context.dt_s;
        let excess_mps = 10.0 * (0.3f64.sin() - 0.1f64.sin());
        let expected = -0.5 * (excess_mps / 0.5).powi(2) * seconds;
        let found = traffic.potential(&objective())[0];
        assert!((found / expected - 1.0).abs() < 1e-3, "{found}, expected {expected}");
        for allowed in [0.0, 0.09, -0.09] {
            assert_eq!(turned(allowed).potential(&objective()), [0.0]);
        }
        // The center of a car may move aside as far as the car turns about an axle of its own.
        let (speed_mps, rate_radps, dt_s) = (10.0, 0.4, traffic.context.dt_s);
        let about = |axle_m: f64| {
            let mut traffic = turned(0.0);
            let slip_rad = (axle_m * rate_radps / speed_mps).atan();
            let mut states: Vec<f64> = traffic.states.flatten_all().unwrap().to_vec1().unwrap();
            let (mut x, mut y) = (0.0, 0.0);
            for (i, state) in states.chunks_exact_mut(3).enumerate() {
                state.copy_from_slice(&[x, y, rate_radps * dt_s * i as f64]);
                let course_rad = rate_radps * dt_s * (i as f64 + 0.5) + slip_rad;
                (x, y) = (x + speed_mps * dt_s * course_rad.cos(), y + speed_mps * dt_s * course_rad.sin());
            }
            let states = Tensor::from_vec(states, traffic.states.shape(), traffic.states.device()).unwrap();
            traffic.states = Var::from_tensor(&states).unwrap();
            traffic.potential(&SlipLimit { limit_rad: 0.01 })[0]
        };
        assert!(about(1.5) == 0.0 && about(-1.5) == 0.0 && about(6.0) < 0.0);
        // A turn all the way around is none.
        assert!(turned(std::f64::consts::TAU).potential(&objective())[0].abs() < 1e-9);
        let mut walking = turned(0.3);
        walking.context.motorized = walking.context.motorized.zeros_like().unwrap();
        assert_eq!(walking.potential(&objective()), [0.0]);
        let mut without_headings = turned(0.3);
        without_headings.context.generates_headings = false;
        assert_eq!(without_headings.potential(&objective()), [0.0]);
    }

    #[test]
    fn gradients_match_and_turn_cars_to_where_they_drive() {
        let traffic = turned(0.3);
        assert_gradients_match(&objective(), &traffic);
        let car = &after_ascent(&objective(), &traffic, 300)[0][0];
        for pair in car[traffic.generated()].windows(2) {
            let [from, to] = pair else { unreachable!() };
            let direction_rad = (to[1] - from[1]).atan2(to[0] - from[0]);
            let slip_rad = (from[2] + to[2]) / 2.0 - direction_rad;
            assert!(slip_rad.abs() < 0.12, "{slip_rad}");
        }
    }
}
