//! One occurrence, or near-occurrence, of a behavior in a scene.

use crate::geometry::angle_difference;
use crate::scene::{Roles, Scene, SceneId, TrackId};
use crate::settings::named;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// The share of an event that is most of it.
const MOST: f64 = 0.6;

/// Whether an event is an example of the behavior or only resembles it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventLabel {
    /// The behavior happens.
    Positive,
    /// A hard negative: close to the behavior without showing it.
    Negative,
}

named! { EventLabel { Positive = "positive", Negative = "negative" } }

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

    /// Whether most of the event happens after the present of `scene`: 60 % of its time, and of a turn's change of
    /// heading.
    pub fn is_mostly_ahead(&self, scene: &Scene) -> bool {
        let present = scene.current_timestep().clamp(self.start_timestep, self.end_timestep);
        let is_most = |ahead: f64, all: f64| ahead >= MOST * all - 1e-9;
        let n = |timesteps: usize| timesteps as f64;
        let agent_idx = self.roles.tracks().next().and_then(|track| scene.track_idx(track));
        let turned_rad = |timesteps: RangeInclusive<usize>| -> f64 {
            let states = timesteps.filter_map(|t| scene.state(agent_idx?, t));
            let headings: Vec<f64> = states.map(|state| state.heading_rad).collect();
            headings.windows(2).map(|pair| angle_difference(pair[1], pair[0])).sum()
        };
        let is_mostly_turned = || {
            let all = self.start_timestep..=self.end_timestep;
            is_most(turned_rad(present..=self.end_timestep).abs(), turned_rad(all).abs())
        };
        self.end_timestep >= scene.n_history
            && is_most(n(self.end_timestep - present), n(self.end_timestep - self.start_timestep))
            && (!self.parameters.contains_key("heading_change_rad") || is_mostly_turned())
    }

    /// The track in this role.
    pub fn track(&self, role: &str) -> Option<&TrackId> {
        self.roles.track(role)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn most_of_an_event_is_its_time_and_of_a_turn_its_change_of_heading() {
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
        let present = scene.current_timestep();
        let event = |before: usize, after: usize| {
            let timesteps = present - before..=present + after;
            BehaviorEvent::new(("left_turn", &["agent"]), &scene, EventLabel::Positive, &[0], timesteps)
        };
        for (before, after, expected) in [(2, 3, true), (3, 3, false), (2, 0, false), (0, 1, true)] {
            assert_eq!(event(before, after).is_mostly_ahead(&scene), expected, "{before}, {after}");
        }
        // 0.4 rad in two timesteps before the present, and as much in three after it.
        let turning = event(2, 3).with("heading_change_rad", 0.8);
        let states = scene.tracks[0].trajectory.entries().iter().enumerate().map(|(t, state)| {
            let since = t as f64 - present as f64;
            let heading_rad = if since < 0.0 { 0.2 * since } else { 0.4 / 3.0 * since };
            state.map(|state| crate::scene::State { heading_rad, ..state })
        });
        let trajectory = crate::scene::Trajectory::new(states.collect());
        scene.tracks[0].trajectory = trajectory;
        assert!(!turning.is_mostly_ahead(&scene));
    }
}
