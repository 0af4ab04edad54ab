//! Drive at a given speed.

use super::motion::{integral, norm, penalty, positions, rate};
use super::{AgentSelector, SceneContext, SceneObjective, default_weight};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Drive at a given speed: J = -½ Σ ∫ ((v(t) - v*) / τ)² dt over the chosen agents and the time from `from_s` on.
///
/// v is the norm of the difference quotient of positions, rounded by 0.05 m/s at zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetSpeed {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1_000_000))]
    pub weight: f64,
    /// Whose speed: `all`, `ego` or a role.
    #[serde(default)]
    pub agents: AgentSelector,
    /// The speed v*, m/s.
    #[schemars(range(min = 0.0))]
    pub speed_mps: f64,
    /// From when on the speed counts, seconds after the present: speed cannot change at once.
    #[serde(default)]
    #[schemars(range(min = 0.0))]
    pub from_s: f64,
}

/// The deviation τ that costs ½ a second, m/s.
const TOLERANCE_MPS: f64 = 1.0;

impl SceneObjective for TargetSpeed {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents]
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let speed_mps = norm(&rate(&positions(states)?, context.dt_s)?)?;
        let values = penalty(&(speed_mps - self.speed_mps)?, TOLERANCE_MPS)?;
        // The difference from t to t + 1 is the speed halfway between.
        let first = context.n_history as f64 - 1.5 + self.from_s / context.dt_s;
        let terms = context.terms(1)?;
        let counts: Vec<f64> = (0..terms.dim(2)?).map(|t| f64::from(u8::from(t as f64 >= first))).collect();
        let n_terms = counts.len();
        let counts = Tensor::from_vec(counts, (1, 1, n_terms), states.device())?.to_dtype(states.dtype())?;
        // At 0 s everything generated counts, also gaps in the history.
        let terms = if self.from_s > 0.0 { terms.broadcast_mul(&counts)? } else { terms };
        integral(&values, &terms, &context.selected(&self.agents)?, context.dt_s)
    }
}
