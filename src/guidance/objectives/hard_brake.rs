//! Brake hard.

use super::motion::{best_potential, norm, nothing, penalty, positions, rate};
use super::{AgentSelector, SceneContext, SceneObjective, Whose, beyond};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Brake hard at some moment, from a sufficient speed.
///
/// With v(t) the speed and b(t) = (v(t) - v(t + W)) / W the mean deceleration over the W = 0.6 s that follow, a moment
/// costs ½ (\[b\] / τ)² + ½ (max(v_least - v, 0) / 1 m/s)², where \[·\] is the distance to the target interval
/// (`max_deceleration_mps2`), 5 to 8 m/s² if there is none. The best moment decides, smoothly: J = -(Σ (c +
/// δ)⁻⁴)^(-1/4) with δ = 0.01, summed over the chosen agents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HardBrake {}

/// The error τ of the deceleration that costs ½, m/s².
const TOLERANCE_MPS2: f64 = 1.0;

/// The smallest initial speed v_least, m/s.
const LEAST_SPEED_MPS: f64 = 4.0;

/// The parameter at which it aims, as the events report it.
const MAX_DECELERATION: &str = "max_deceleration_mps2";
/// The default deceleration, m/s².
const ANY_MPS2: [f64; 2] = [5.0, 8.0];
/// The time over which braking is measured, seconds: the shortest duration of hard braking plus the smoothing of
/// speeds.
const WINDOW_S: f64 = 0.6;

impl SceneObjective for HardBrake {
    fn whose(&self) -> Whose {
        Whose::Any("agent")
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[MAX_DECELERATION]
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let (n_rows, n_agents, n_timesteps, _) = states.dims4()?;
        let n_window = (WINDOW_S / context.dt_s).round().max(1.0) as usize;
        // Speeds are between timesteps: there is one less, and a moment needs two of them, a window apart.
        let Some(n_moments) = n_timesteps.checked_sub(n_window + 1).filter(|n| *n > 0) else {
            return nothing(states);
        };
        let speed_mps = norm(&rate(&positions(states)?, context.dt_s)?)?;
        let before = speed_mps.narrow(2, 0, n_moments)?;
        let lost = (&before - speed_mps.narrow(2, n_window, n_moments)?)?;
        let braking = (lost * (1.0 / (n_window as f64 * context.dt_s)))?.reshape((n_rows, n_agents * n_moments))?;
        let wanted = context.wanted(MAX_DECELERATION, ANY_MPS2, states)?;
        let missed = beyond(&braking, &wanted)?.reshape((n_rows, n_agents, n_moments))?;
        let slow = (LEAST_SPEED_MPS - before)?.relu()?;
        let parts = [penalty(&missed, TOLERANCE_MPS2)?, penalty(&slow, 1.0)?];
        (best_potential(&parts, &context.terms(n_window + 1)?)? * context.selected(agents)?)?.sum(1)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, assert_gradients_match};
    use super::*;

    /// A car that drives 12 m/s and brakes with 5.5 m/s² from the first generated timestep on.
    fn braking() -> Traffic {
        let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 12.0)]);
        let dt_s = traffic.context.dt_s;
        let braked_m = |t: usize| {
            let time_s = t.saturating_sub(traffic.generated().start) as f64 * dt_s;
            5.5 * time_s * time_s / 2.0
        };
        let states = (0..12).flat_map(|t| [12.0 * t as f64 * dt_s - braked_m(t), 0.0, 0.0]).collect::<Vec<_>>();
        let states = Tensor::from_vec(states, traffic.states.shape(), &candle_core::Device::Cpu).expect("shape");
        Traffic { states: candle_core::Var::from_tensor(&states).expect("variable"), context: traffic.context }
    }

    #[test]
    fn gradients_match_and_only_the_wanted_deceleration_costs_nothing() {
        let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 12.0), (30.0, 4.0, 0.0, 5.0)]);
        assert_gradients_match(&HardBrake {}, &traffic.aiming_at(MAX_DECELERATION, [5.0, 6.0]));
        let value = |range| braking().aiming_at(MAX_DECELERATION, range).potential(&HardBrake {})[0];
        assert!(value([5.0, 6.0]) > -0.05, "{}", value([5.0, 6.0]));
        assert!(value([8.0, 9.0]) < -1.0 && value([1.0, 2.0]) < value([5.0, 6.0]));
    }

    #[test]
    fn who_is_not_asked_is_left_alone() {
        let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 12.0), (30.0, 4.0, 0.0, 5.0)]);
        let gradient = traffic.gradient(&HardBrake {});
        assert!(gradient[gradient.len() / 2..].iter().all(|g| *g == 0.0));
    }

    #[test]
    fn the_cost_is_that_of_the_missing_deceleration_whoever_asks_for_it() {
        // At a constant 12 m/s every one of the moments lacks 5 m/s²: 12.5 each, over the fourth root of their number.
        let mut traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 12.0)]);
        // Moments that count end at generated timesteps.
        let n_moments = 12.0 - 4.0;
        let value = traffic.potential(&HardBrake {})[0];
        assert!((value + 12.51 / f64::powf(n_moments, 0.25)).abs() < 1e-3, "{value}");
        traffic.context.targets[0] = [(MAX_DECELERATION.to_owned(), [3.0, 4.0])].into();
        let aimed = traffic.potential(&HardBrake {})[0];
        assert!((aimed + 4.51 / f64::powf(n_moments, 0.25)).abs() < 1e-3, "{aimed}");
        // A crawling car cannot brake hard.
        let crawling = Traffic::straight(&[(0.0, 0.0, 0.0, 1.0)]).potential(&HardBrake {})[0];
        assert!(crawling < value - 1.0, "{crawling}");
    }
}
