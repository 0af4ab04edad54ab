//! Be at a given place at a given time.

use super::motion::{headings, penalty, positions};
use super::{AgentSelector, SceneContext, SceneObjective, Whose};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Be at a given place at a given time: J = -½ Σ ‖p(t*) - g‖² / τ² over the chosen agents.
///
/// Agents without a state at that time or at present do not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// The place g, meters ahead of where each agent is at present, along its heading there.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub x_m: f64,
    /// The place g, meters to the left of it.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub y_m: f64,
    /// The time t*, seconds after the present. Left out: the last timestep, as also for times beyond it.
    #[serde(default)]
    #[schemars(range(min = 0.0))]
    pub time_s: Option<f64>,
}

/// The distance τ from the place that costs ½, meters.
const TOLERANCE_M: f64 = 1.0;

impl SceneObjective for Goal {
    fn whose(&self) -> Whose {
        Whose::Any(AgentSelector::EGO)
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let n_timesteps = states.dim(2)?;
        let (present, last) = (context.n_history.saturating_sub(1), n_timesteps.saturating_sub(1));
        let ahead = self.time_s.map_or(last, |time_s| (time_s / context.dt_s).round() as usize);
        let timestep = present.saturating_add(ahead).min(last);
        let at = |tensor: &Tensor, timestep: usize| tensor.narrow(2, timestep, 1)?.squeeze(2);
        let counts = (at(&context.terms(0)?, timestep)? * context.selected(agents)?)?;
        let counts = (counts * at(&context.valid, present)?)?;
        let start = at(states, present)?.unsqueeze(2)?;
        let (sin, cos) = (headings(&start)?.sin()?, headings(&start)?.cos()?);
        let x = ((&cos * self.x_m)? - (&sin * self.y_m)?)?;
        let y = ((sin * self.x_m)? + (cos * self.y_m)?)?;
        let goal = (positions(&start)? + Tensor::cat(&[x, y], 3)?)?.squeeze(2)?;
        let miss_m = (at(&positions(states)?, timestep)? - goal)?;
        (penalty(&miss_m, TOLERANCE_M)?.sum(2)? * counts)?.sum(1)
    }
}
