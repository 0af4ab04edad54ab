//! Does the event of a scenario happen in the driven states?

use super::situation::Situation;
use crate::behavior::{BehaviorConfig, BehaviorEvent, EventLabel};
use crate::scene::Scene;

/// Behaviors defined by the ego not reacting in time, or nearly so: its own motion decides them.
const DECIDED_BY_EGO: [&str; 2] = ["collision", "near_miss"];

/// Whether the ego decides if this behavior happens, so that the plan stays as it is.
pub(crate) fn is_decided_by_ego(behavior: Option<&str>) -> bool {
    behavior.is_some_and(|id| DECIDED_BY_EGO.contains(&id))
}

impl Situation {
    /// The event of the scenario, with the same roles, if the definition with default options finds it in a `scene`
    /// with its agents. `None` also for a scenario without an event.
    pub(crate) fn event_in(&self, scene: &Scene) -> Option<BehaviorEvent> {
        let behavior = BehaviorConfig::from_id(self.behavior.as_deref().filter(|_| !self.roles.is_empty())?)?;
        let is_meant = |event: &BehaviorEvent| {
            event.label == EventLabel::Positive
                && event.end_timestep >= scene.n_history
                && event.roles.tracks().eq(self.roles.iter().map(|idx| &self.scene.tracks[*idx].id))
        };
        behavior.build().detect(scene).into_iter().find(is_meant)
    }
}
