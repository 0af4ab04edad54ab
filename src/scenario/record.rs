//! A generated scenario with its request, the findings in it and its judgment.

use super::{Assessment, RequestTag};
use crate::behavior::{Behavior, BehaviorEntry, BehaviorEvent, EventLabel, Explanation, explanation, needs_cause};
use crate::metrics::Ending;
use crate::scene::{Scenario, Track};

/// A generated scenario, with its request and the findings in it.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioRecord {
    /// The scenario. Its states are rounded as the store rounds them (`store::as_stored`) before it is verified, so
    /// that the verified states are the written ones.
    pub scenario: Scenario,
    /// The sweep that it belongs to.
    pub sweep: String,
    /// The requested behavior; `None` for unconditional sampling.
    pub requested_behavior: Option<String>,
    /// Whether the miner found the requested behavior with the requested roles; `false` when none was requested.
    pub verified: bool,
    /// The positive events of the requested behavior that the miner found, those with the requested roles first; their
    /// `scene_id` is the scene's.
    pub events: Vec<BehaviorEvent>,
    /// Whether the recording already showed the requested behavior with these roles.
    pub recorded_event: bool,
    /// Its judgment; `None` before it is evaluated. Only the corpus keeps it.
    pub assessment: Option<Assessment>,
    /// The shard of the run's samples in which it was generated.
    pub shard: usize,
    /// The request behind it, with its outcome there; `None` for scenarios of plain sweeps.
    pub request: Option<RequestTag>,
}

impl ScenarioRecord {
    /// Whether the requested behavior is a collision.
    pub fn asks_for_collision(&self) -> bool {
        BehaviorEntry::is_collision(self.requested_behavior.as_deref())
    }

    /// The event that represents a verified scenario in tables: the first positive one of the requested behavior.
    /// Verification puts events with the requested roles first.
    pub fn main_event(&self) -> Option<&BehaviorEvent> {
        let requested = self.requested_behavior.as_ref().filter(|_| self.verified)?;
        self.events.iter().find(|event| event.behavior == *requested && event.label == EventLabel::Positive)
    }

    /// The vehicle to which the requested event happens. `None` if nothing was requested or found, or there is no such
    /// vehicle.
    pub fn subject(&self) -> Option<&Track> {
        self.subject_idx().map(|agent_idx| &self.scenario.scene.tracks[agent_idx])
    }

    /// Its ending for that vehicle, or for the first of the event if there is no such vehicle, with its index. `None`
    /// also if a collision was requested.
    pub fn ending(&self) -> Option<(usize, Ending)> {
        let event = self.main_event().filter(|_| !self.asks_for_collision())?;
        let scene = &self.scenario.scene;
        let first = || event.roles.tracks().next().and_then(|track| scene.track_idx(track));
        let subject_idx = event.subject_idx(scene).or_else(first)?;
        Some((subject_idx, Ending::of(scene, subject_idx, event.start_timestep)?))
    }

    /// Why its event happens: `None` if it needs no cause, `Some(None)` if it needs one and has none.
    pub fn explanation(&self) -> Option<Option<Explanation>> {
        let event = self.main_event().filter(|event| needs_cause(&event.behavior))?;
        Some(explanation(&self.scenario.scene, event))
    }

    /// Whether the road users of its event move as drivers do, as the requested one of these behaviors says.
    pub fn is_as_driven(&self, behaviors: &[Box<dyn Behavior>]) -> bool {
        self.main_event().is_none_or(|event| {
            behaviors.iter().filter(|behavior| behavior.id() == event.behavior).all(|it| it.is_as_driven(event))
        })
    }

    /// The index of that vehicle among the tracks.
    pub fn subject_idx(&self) -> Option<usize> {
        self.main_event()?.subject_idx(&self.scenario.scene)
    }
}
