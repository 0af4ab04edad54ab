//! Be at a given place at a given time.

use super::motion::{headings, penalty, positions};
use super::{AgentSelector, SceneContext, SceneObjective, default_weight, ego};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Be at a given place at a given time: J = -½ Σ ‖p(t*) - g‖² / τ² over the chosen agents.
///
/// Agents without a state at that time do not count, nor, with `frame = "agent"`, those without one at present.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1_000_000))]
    pub weight: f64,
    /// The agents that must be there: `all`, `ego` or a role.
    #[serde(default = "ego")]
    pub agents: AgentSelector,
    /// The frame of the place.
    #[serde(default)]
    pub frame: GoalFrame,
    /// The place g, along the x axis of its frame (ahead), meters.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub x_m: f64,
    /// The place g, along the y axis of its frame (to the left), meters.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub y_m: f64,
    /// The time t*, seconds after the present. Left out: the last timestep, as also for times beyond it.
    #[serde(default)]
    #[schemars(range(min = 0.0))]
    pub time_s: Option<f64>,
}

/// The distance τ from the place that costs ½, meters.
const TOLERANCE_M: f64 = 1.0;

/// Frame of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GoalFrame {
    /// Origin at each agent's own position at present, x axis along its heading there.
    #[default]
    Agent,
    /// The frame of the agent at the center of the scene: its position and heading at present.
    Ego,
}

impl SceneObjective for Goal {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents]
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let (n_rows, n_agents, n_timesteps, _) = states.dims4()?;
        let (present, last) = (context.n_history.saturating_sub(1), n_timesteps.saturating_sub(1));
        let ahead = self.time_s.map_or(last, |time_s| (time_s / context.dt_s).round() as usize);
        let timestep = present.saturating_add(ahead).min(last);
        let at = |tensor: &Tensor, timestep: usize| tensor.narrow(2, timestep, 1)?.squeeze(2);
        let mut counts = (at(&context.terms(0)?, timestep)? * context.selected(&self.agents)?)?;
        let goal = match self.frame {
            GoalFrame::Ego => {
                let goal = Tensor::new(&[[[self.x_m, self.y_m]]], states.device())?.to_dtype(states.dtype())?;
                goal.broadcast_as((n_rows, n_agents, 2))?
            }
            GoalFrame::Agent => {
                counts = (counts * at(&context.valid, present)?)?;
                let start = at(states, present)?.unsqueeze(2)?;
                let (sin, cos) = (headings(&start)?.sin()?, headings(&start)?.cos()?);
                let x = ((&cos * self.x_m)? - (&sin * self.y_m)?)?;
                let y = ((sin * self.x_m)? + (cos * self.y_m)?)?;
                (positions(&start)? + Tensor::cat(&[x, y], 3)?)?.squeeze(2)?
            }
        };
        let miss_m = (at(&positions(states)?, timestep)? - goal)?;
        (penalty(&miss_m, TOLERANCE_M)?.sum(2)? * counts)?.sum(1)
    }
}
