//! One occurrence, or near-occurrence, of a behavior in a scene.

use crate::scene::{Roles, Scene, SceneId, TrackId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Whether an event is an example of the behavior or only resembles it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventLabel {
    /// The behavior happens.
    Positive,
    /// A hard negative: close to the behavior without showing it.
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
    /// The agents that took part: (role, track), in the behavior's order of roles.
    pub roles: Roles,
    /// First timestep of the event.
    pub start_timestep: usize,
    /// Last timestep of the event.
    pub end_timestep: usize,
    /// The figures of interest to a safety engineer; names end in their unit, such as `gap_m`. A parameter that is not
    /// defined for an event, such as the time to collision without a collision course, is absent.
    pub parameters: BTreeMap<String, f64>,
}

impl BehaviorEvent {
    /// An event in `scene` without parameters. `agents` are indices of tracks, in the order of `roles`.
    pub(crate) fn new(
        (behavior, roles): (&str, &[&str]),
        scene: &Scene,
        label: EventLabel,
        agents: &[usize],
        timesteps: RangeInclusive<usize>,
    ) -> Self {
        let role = |(role, agent_idx): (&&str, &usize)| ((*role).to_owned(), scene.tracks[*agent_idx].id.clone());
        Self {
            behavior: behavior.to_owned(),
            scene_id: scene.id.clone(),
            label,
            roles: roles.iter().zip(agents).map(role).collect(),
            start_timestep: *timesteps.start(),
            end_timestep: *timesteps.end(),
            parameters: BTreeMap::new(),
        }
    }

    /// The event with one more parameter; a value that is absent or not finite adds none.
    pub(crate) fn with(mut self, name: &str, value: impl Into<Option<f64>>) -> Self {
        if let Some(value) = value.into().filter(|v| v.is_finite()) {
            self.parameters.insert(name.to_owned(), value);
        }
        self
    }

    /// The track in this role.
    pub fn track(&self, role: &str) -> Option<&TrackId> {
        self.roles.track(role)
    }
}
