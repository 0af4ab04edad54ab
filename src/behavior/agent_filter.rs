//! Which kinds of road users does a behavior concern?

use crate::scene::AgentClass;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A choice of road users by class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AgentFilter {
    /// Vehicles, buses, motorcycles, and agents of unknown class (all of Argoverse 1).
    Motorized,
    /// All road users except static objects.
    RoadUsers,
    /// Everything that has a track.
    All,
}

impl AgentFilter {
    /// Whether agents of `class` are considered.
    pub const fn admits(self, class: AgentClass) -> bool {
        match self {
            Self::Motorized => class.is_motorized(),
            Self::RoadUsers => !matches!(class, AgentClass::Static),
            Self::All => true,
        }
    }
}
