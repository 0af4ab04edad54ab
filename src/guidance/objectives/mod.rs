//! Objectives for trajectories: wishes for positions and headings, without a classifier.
//!
//! One objective per file: its struct is its configuration, its docstring its definition. A new one needs its file and
//! an entry in the list `objectives!`.
//!
//! All have in common: a log potential J is at most 0, and is 0, up to rounding, where the objective is met. It is once
//! continuously differentiable in the states unless its docstring says otherwise. It is summed over agents (or pairs)
//! and integrated over time in seconds, so that neither the number of bystanders nor the time step changes how hard an
//! agent is pushed. A term counts if all the states it reads are valid and at least one of them is generated. Padding
//! never contributes, and observed states only in comparison with generated ones.

mod acceleration_limit;
mod approach;
mod box_separation;
mod collision;
mod cut_in;
mod driven_paths;
mod hard_brake;
mod lane_change;
mod motion;
mod no_collision;
mod one_agent;
mod pairs;
mod slip_limit;
mod stay_on_road;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

pub use acceleration_limit::AccelerationLimit;
pub use collision::Collision;
pub use cut_in::CutIn;
pub use hard_brake::HardBrake;
pub use lane_change::LaneChange;
pub(super) use motion::nothing;
pub use no_collision::NoCollision;
pub use slip_limit::SlipLimit;
pub use stay_on_road::StayOnRoad;

use super::{AgentSelector, SceneContext};
use crate::settings::{self, Issue};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An objective for the trajectories of a scene.
pub trait SceneObjective {
    /// The agents whose motion it judges by default.
    fn whose(&self) -> Whose {
        Whose::Any(AgentSelector::ALL)
    }
    /// The other agents that its settings name.
    fn others(&self) -> Vec<&AgentSelector> {
        Vec::new()
    }
    /// The parameters of an event at which it can aim, row by row ([`super::Target`]).
    fn aims_at(&self) -> &'static [&'static str] {
        &[]
    }
    /// Rejects settings that contradict each other.
    fn validate(&self) -> settings::Result {
        Ok(())
    }
    /// The log potential J ≤ 0 of each row, (B), higher is better, without the weight, for the motion of `agents`.
    /// `states` (B, A, T, 3) are positions and headings in meters and radians of each row's ego frame. Differentiable
    /// in them, row by row.
    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor>;
}

/// The agents whose motion an objective judges by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Whose {
    /// The agents with this name; settings may name others, several at once.
    Any(&'static str),
    /// The agent with this name; settings may name another one.
    One(&'static str),
}

/// An objective with its options and its weight: `{ kind = "acceleration_limit", agents = "other", limit_mps2 = 3.0 }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(extend("unevaluatedProperties" = false))]
pub struct ObjectiveConfig {
    /// Weight relative to other objectives. It is what scales a cost: the errors that cost ½ are constants of each
    /// objective.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1_000_000))]
    pub weight: f64,
    /// Whose motion: a role, `ego`, or `all` unless a single agent is meant. Left out: those that the objective usually
    /// concerns, `all` for rules of traffic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agents: Option<AgentSelector>,
    /// The objective with its options.
    #[serde(flatten)]
    pub kind: ObjectiveKind,
}

/// Lists the objectives: each has a type, and a name in configs and provenance.
macro_rules! objectives {
    ($($(#[$doc:meta])* $Objective:ident = $kind:literal,)*) => {
        /// The objectives with their options.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(tag = "kind", deny_unknown_fields)]
        pub enum ObjectiveKind {
            $($(#[$doc])* #[serde(rename = $kind)] $Objective($Objective),)*
        }

        $(impl From<$Objective> for ObjectiveKind {
            fn from(objective: $Objective) -> Self {
                Self::$Objective(objective)
            }
        })*

        impl ObjectiveConfig {
            /// The objective.
            pub fn objective(&self) -> &dyn SceneObjective {
                match &self.kind { $(ObjectiveKind::$Objective(objective) => objective,)* }
            }

            /// Its name.
            pub const fn kind(&self) -> &'static str {
                match &self.kind { $(ObjectiveKind::$Objective(_) => $kind,)* }
            }
        }
    };
}

objectives! {
    /// Accelerate, brake and turn no harder than a limit.
    AccelerationLimit = "acceleration_limit",
    /// Keep the heading along the motion.
    SlipLimit = "slip_limit",
    /// Stay on the road.
    StayOnRoad = "stay_on_road",
    /// Avoid collisions.
    NoCollision = "no_collision",
    /// Move into the lane of another agent, ahead of it.
    CutIn = "cut_in",
    /// Brake hard.
    HardBrake = "hard_brake",
    /// Drive into each other.
    Collision = "collision",
    /// Move over to the lane beside one's own.
    LaneChange = "lane_change",
}

/// Why an objective cannot work.
#[derive(Debug, thiserror::Error)]
pub enum InvalidObjective {
    /// One of its settings.
    #[error(transparent)]
    Setting(#[from] Issue),
    /// It names agents that do not exist.
    #[error("no agent has the role `{role}`, expected one of {known}")]
    Role {
        /// The name as written.
        role: String,
        /// The values that can be written.
        known: String,
    },
}

impl ObjectiveConfig {
    /// The objective with this weight.
    pub fn new(weight: f64, objective: impl Into<ObjectiveKind>) -> Self {
        Self { weight, agents: None, kind: objective.into() }
    }

    /// The agents whose motion it judges.
    pub fn agents(&self) -> AgentSelector {
        let (Whose::Any(usual) | Whose::One(usual)) = self.objective().whose();
        self.agents.clone().unwrap_or_else(|| AgentSelector::new(usual))
    }

    /// This configuration, with the name of the agents spelled out.
    #[must_use]
    pub fn spelled_out(&self) -> Self {
        Self { agents: Some(self.agents()), ..self.clone() }
    }

    /// The log potential of each row, (B): [`SceneObjective::log_potential`].
    ///
    /// # Errors
    /// When shapes do not fit, or no agent has a role.
    pub fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        self.objective().log_potential(&self.agents(), states, context)
    }

    /// Rejects settings that cannot work in a sweep whose behavior has these `roles`.
    pub fn validate(&self, roles: &[&str]) -> settings::Result<(), InvalidObjective> {
        let (objective, agents) = (self.objective(), self.agents());
        settings::check_ranges(self)?;
        if let Whose::One(_) = objective.whose() {
            one_agent("agents", &agents)?;
        }
        objective.validate()?;
        match std::iter::once(&agents).chain(objective.others()).find(|agents| !agents.is_known(roles)) {
            Some(agents) => {
                let others = roles.iter().copied().filter(|role| *role != AgentSelector::EGO);
                let known: Vec<&str> = [AgentSelector::ALL, AgentSelector::EGO].into_iter().chain(others).collect();
                Err(InvalidObjective::Role { role: agents.name().to_owned(), known: known.join(", ") })
            }
            None => Ok(()),
        }
    }
}

/// The agent around which a scene is cut out, or in that role.
fn ego() -> AgentSelector {
    AgentSelector::new(AgentSelector::EGO)
}

/// The second of two agents, neither of which is the ego.
fn second() -> AgentSelector {
    AgentSelector::new("second")
}

/// How far `x` (B, N) is outside the interval of its row, (B, 2).
fn beyond(x: &Tensor, interval: &Tensor) -> Result<Tensor> {
    let (least, most) = (interval.narrow(1, 0, 1)?, interval.narrow(1, 1, 1)?);
    x.broadcast_sub(&least)?.neg()?.relu()? + x.broadcast_sub(&most)?.relu()?
}

/// Refuses `all` where a single agent is required.
fn one_agent(key: &str, selector: &AgentSelector) -> settings::Result {
    match selector.name() {
        AgentSelector::ALL => {
            Err(Issue::new(key, "is \"all\", expected one agent: a role of the behavior, or \"ego\""))
        }
        _ => Ok(()),
    }
}

/// One of the two sides, seen in driving direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// To the left.
    Left,
    /// To the right.
    Right,
}

impl Side {
    /// +1 for left, -1 for right.
    const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

const fn default_weight() -> f64 {
    1.0
}
