//! The agents whose motion an objective judges.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Agents by name: `all`; a role of the requested behavior, such as `other`; or `ego`. Where the behavior has no role
/// of that name, `ego` is the agent at the center of the scene: the one with the first role, or the scene's ego agent
/// if no behavior is requested.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct AgentSelector(String);

impl AgentSelector {
    /// All agents.
    pub const ALL: &'static str = "all";
    /// The agent at the center of the scene, unless a role has this name.
    pub const EGO: &'static str = "ego";

    /// The agents of this name.
    pub fn new(name: &str) -> Self {
        Self(name.to_owned())
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.0
    }

    /// Whether the name stands for an agent in a sweep with these roles.
    pub fn is_known(&self, roles: &[&str]) -> bool {
        [Self::ALL, Self::EGO].contains(&self.name()) || roles.contains(&self.name())
    }
}

impl Default for AgentSelector {
    fn default() -> Self {
        Self::new(Self::ALL)
    }
}
