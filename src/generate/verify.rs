//! Does a generated scenario show the requested behavior? The miner that defines the behavior decides.

use crate::behavior::{Behavior, BehaviorEvent, EventLabel};
use crate::scene::{Roles, Scene};

/// The positive events of `behavior` in a scene, those with the requested `roles` that happen mostly after the present
/// first, and whether there are any of these; without roles, events of any agents are.
pub fn requested_events(behavior: &dyn Behavior, roles: &Roles, scene: &Scene) -> (bool, Vec<BehaviorEvent>) {
    let is_requested =
        |event: &BehaviorEvent| (roles.is_empty() || event.roles == *roles) && event.is_mostly_ahead(scene);
    let (mut events, others): (Vec<_>, Vec<_>) = positive_events(behavior, scene).into_iter().partition(is_requested);
    let is_found = !events.is_empty();
    events.extend(others);
    (is_found, events)
}

pub(super) fn positive_events(behavior: &dyn Behavior, scene: &Scene) -> Vec<BehaviorEvent> {
    behavior.detect(scene).into_iter().filter(|event| event.label == EventLabel::Positive).collect()
}
