//! One occurrence, or near-occurrence, of a behavior in a scene.

use crate::scene::{SceneId, TrackId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Whether an event is an example of the behavior or one that only looks like it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventLabel {
    /// The behavior happens.
    Positive,
    /// A hard negative: close to the behavior without being it.
    Negative,
}

impl EventLabel {
    /// The name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Positive => "positive",
            Self::Negative => "negative",
        }
    }
}

/// An event found in a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BehaviorEvent {
    /// Name of the behavior.
    pub behavior: String,
    /// The scene it was found in.
    pub scene_id: SceneId,
    /// Example or hard negative.
    pub label: EventLabel,
    /// Who took part: (role, track), in the behavior's order of roles.
    pub roles: Vec<(String, TrackId)>,
    /// First timestep of the event.
    pub start_timestep: usize,
    /// Last timestep of the event.
    pub end_timestep: usize,
    /// What a safety engineer asks for; names end in their unit, such as `gap_m`.
    pub parameters: BTreeMap<String, f64>,
}

impl BehaviorEvent {
    /// The track in this role.
    pub fn track(&self, role: &str) -> Option<&TrackId> {
        self.roles.iter().find(|(name, _)| name == role).map(|(_, track)| track)
    }
}
