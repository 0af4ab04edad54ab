//! Accelerate, brake and turn no harder than a given limit.

use super::motion::{integral, norm, penalty, positions, rate};
use super::{AgentSelector, SceneContext, SceneObjective};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Accelerate, brake and turn no harder than a limit: J = -½ Σ ∫ (max(‖a(t)‖ - a_max, 0) / τ)² dt over the chosen
/// agents.
///
/// a is the second difference quotient of positions, in all directions, its norm rounded by 0.05 m/s² at zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AccelerationLimit {
    /// The limit a_max, m/s².
    #[serde(default = "default_limit_mps2")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub limit_mps2: f64,
}

/// The excess τ that costs ½ a second, m/s².
const TOLERANCE_MPS2: f64 = 1.0;

const fn default_limit_mps2() -> f64 {
    4.0
}

impl SceneObjective for AccelerationLimit {
    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let velocity_mps = rate(&positions(states)?, context.dt_s)?;
        let acceleration_mps2 = norm(&rate(&velocity_mps, context.dt_s)?)?;
        let values = penalty(&(acceleration_mps2 - self.limit_mps2)?.relu()?, TOLERANCE_MPS2)?;
        integral(&values, &context.terms(2)?, &context.selected(agents)?, context.dt_s)
    }
}
