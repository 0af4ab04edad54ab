//! Drive no faster than a given speed.

use super::motion::{integral, norm, penalty, positions, rate};
use super::{AgentSelector, SceneContext, SceneObjective};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Drive no faster than a given speed: J = -½ Σ ∫ (max(v(t) - v_max, 0) / τ)² dt over the chosen agents.
///
/// v is the norm of the difference quotient of positions, rounded by 0.05 m/s at zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpeedLimit {
    /// The limit v_max, m/s.
    #[schemars(range(min = 0.0))]
    pub limit_mps: f64,
}

/// The excess τ that costs ½ a second, m/s.
const TOLERANCE_MPS: f64 = 1.0;

impl SceneObjective for SpeedLimit {
    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let speed_mps = norm(&rate(&positions(states)?, context.dt_s)?)?;
        let values = penalty(&(speed_mps - self.limit_mps)?.relu()?, TOLERANCE_MPS)?;
        integral(&values, &context.terms(1)?, &context.selected(agents)?, context.dt_s)
    }
}
