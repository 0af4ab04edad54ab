//! Come to a halt before a line.

use super::motion::{headings, integral, norm, penalty, positions, rate};
use super::{AgentSelector, SceneContext, SceneObjective, Whose};
use candle_core::{D, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Come to a halt with the front at a line across the way, `distance_m` ahead of where its front is at present.
///
/// With s(t) the way of an agent's front beyond the line, measured along its heading at present,
///
/// J = -½ Σ { ∫ (max(s(t), 0) / τ_s)² dt + (s(T) / τ_s)² + (v(T) / τ_v)² }
///
/// over the chosen agents: never beyond the line, at it in the end, and standing then. Agents without a state at
/// present do not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StopAtLine {
    /// How far ahead of the agent's front the line lies at present, meters.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub distance_m: f64,
}

/// The final speed τ_v that costs ½, m/s.
const TOLERANCE_MPS: f64 = 0.5;

/// The way τ_s beyond or before the line that costs ½, meters.
const TOLERANCE_M: f64 = 1.0;

impl SceneObjective for StopAtLine {
    fn whose(&self) -> Whose {
        Whose::Any(AgentSelector::EGO)
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let (present, dt_s) = (context.n_history.saturating_sub(1), context.dt_s);
        let start = states.narrow(2, present, 1)?;
        let along = Tensor::cat(&[headings(&start)?.cos()?, headings(&start)?.sin()?], 3)?;
        let way_m = positions(states)?.broadcast_sub(&positions(&start)?)?.broadcast_mul(&along)?.sum(D::Minus1)?;
        let beyond_m = (way_m - self.distance_m)?;
        let was_there = context.valid.narrow(2, present, 1)?.squeeze(2)?;
        let agents = (context.selected(agents)? * was_there)?;
        let last = |values: &Tensor, terms: &Tensor| {
            let at = values.dim(2)? - 1;
            integral(&values.narrow(2, at, 1)?, &terms.narrow(2, at, 1)?, &agents, 1.0)
        };
        let speed_mps = norm(&rate(&positions(states)?, dt_s)?)?;
        let (terms, steps) = (context.terms(0)?, context.terms(1)?);
        let crossing = integral(&penalty(&beyond_m.relu()?, TOLERANCE_M)?, &terms, &agents, dt_s)?;
        let place = last(&penalty(&beyond_m, TOLERANCE_M)?, &terms)?;
        let halt = last(&penalty(&speed_mps, TOLERANCE_MPS)?, &steps)?;
        (crossing + place)? + halt
    }
}
