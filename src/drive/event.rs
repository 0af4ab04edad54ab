//! Does the event of a scenario happen in what was driven?

use super::situation::Situation;
use crate::behavior::{BehaviorConfig, BehaviorEvent, EventLabel};
use crate::scene::Scene;

impl Situation {
    /// The event of the scenario, with the same roles, as the definition with default options finds it in a `scene`
    /// with its agents. `None` also for a scenario without an event.
    pub(super) fn event_in(&self, scene: &Scene) -> Option<BehaviorEvent> {
        let behavior = BehaviorConfig::from_id(self.behavior.as_deref().filter(|_| !self.roles.is_empty())?)?;
        let is_meant = |event: &BehaviorEvent| {
            event.label == EventLabel::Positive
                && event.end_timestep >= scene.n_history
                && event.roles.tracks().eq(self.roles.iter().map(|idx| &self.scene.tracks[*idx].id))
        };
        behavior.build().detect(scene).into_iter().find(is_meant)
    }
}
