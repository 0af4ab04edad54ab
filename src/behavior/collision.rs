//! Collision: do two road users drive into each other?

use super::maneuver::Maneuver;
use super::swept_boxes::SweptBoxes;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::angle_difference;
use crate::scene::{AgentClass, Extent, Scene, Track};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "collision";
/// The two road users, in the order of tracks.
pub(super) const ROLES: &[&str] = &["first", "second"];
/// Names of the parameters of its events, defined at [`Collision`].
pub(super) const PARAMETERS: &[&str] =
    &["relative_speed_mps", "first_speed_mps", "second_speed_mps", "heading_difference_rad", "bearing_rad"];

/// Smallest relative speed before they touch, m/s: below it, overlaps are errors of boxes and tracks.
const MIN_RELATIVE_MPS: f64 = 0.5;
/// Boxes that come closer than this without touching are a hard negative, meters.
const NEGATIVE_DISTANCE_M: f64 = 1.0;

/// Two road users (`first` and `second`) drive into each other.
///
/// **Positive**: the boxes overlap at a timestep but not at the one before, at which the relative speed was at least
/// 0.5 m/s. The event starts and is complete at the first such timestep. An agent without a recorded size counts with
/// half its nominal length and width.
///
/// *What does not count*: boxes that overlap already when both are first tracked, or at present, as in some recordings;
/// static objects. The motion after the contact is meaningless: nothing here models what a collision does to vehicles.
///
/// **Negative**: boxes that come closer than 1 m and never touch.
///
/// Parameters, at the last timestep before they touch: `relative_speed_mps` (of one seen from the other),
/// `first_speed_mps`, `second_speed_mps`, `heading_difference_rad` (0 to π: from behind, from the side, head-on), and
/// `bearing_rad`, where the second is as seen from the first (0 to π: ahead, beside, behind).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Collision {}

impl Collision {
    fn detect_pair(scene: &Scene, pair: [usize; 2], [first, second]: [&SweptBoxes; 2]) -> Option<BehaviorEvent> {
        let both = || first.both_at(second, 0..scene.n_timesteps);
        let present = scene.current_timestep();
        let touches = both().find(|(_, one, other)| one.overlaps(other)).map(|(timestep, ..)| timestep);
        let Some(timestep) = touches else {
            let near: Vec<usize> = both()
                .filter(|(_, one, other)| one.is_closer_than(other, NEGATIVE_DISTANCE_M))
                .map(|(timestep, ..)| timestep)
                .collect();
            let span = *near.first()?..=*near.last()?;
            return Some(BehaviorEvent::new((ID, ROLES), scene, EventLabel::Negative, &pair, span));
        };
        let overlaps_at_present = both().any(|(t, one, other)| t == present && one.overlaps(other));
        let before = timestep.checked_sub(1)?;
        let state = |agent_idx: usize| scene.state(agent_idx, before).filter(|state| state.is_finite());
        let [one, other] = [state(pair[0])?, state(pair[1])?];
        let relative_mps = (one.velocity - other.velocity).norm();
        if overlaps_at_present || relative_mps < MIN_RELATIVE_MPS {
            return None;
        }
        let toward = other.position - one.position;
        let event = BehaviorEvent::new((ID, ROLES), scene, EventLabel::Positive, &pair, timestep..=timestep)
            .with("relative_speed_mps", relative_mps)
            .with("first_speed_mps", one.speed_mps())
            .with("second_speed_mps", other.speed_mps())
            .with("heading_difference_rad", angle_difference(one.heading_rad, other.heading_rad).abs())
            .with("bearing_rad", angle_difference(toward.angle(), one.heading_rad).abs());
        Some(event)
    }
}

impl Behavior for Collision {
    fn id(&self) -> &'static str {
        ID
    }

    fn admits(&self, class: AgentClass) -> bool {
        class.is_road_user()
    }

    /// Events name the two agents in the order of tracks, so requests must do the same.
    fn completed(&self, _scene: &Scene, pair: [usize; 2]) -> Option<Vec<usize>> {
        (pair[0] < pair[1]).then(|| pair.to_vec())
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["relative_speed_mps", "heading_difference_rad", "bearing_rad"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |pair| self.crashes(scene, pair))
    }

    /// At most one event a pair, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let cores = with_cores(scene);
        let admitted = cores.tracks.iter().enumerate().filter(|(_, track)| track.class.is_road_user());
        let sweeps: Vec<(usize, SweptBoxes)> =
            admitted.filter_map(|(agent_idx, track)| Some((agent_idx, SweptBoxes::new(track)?))).collect();
        let pairs =
            sweeps.iter().enumerate().flat_map(|(i, one)| sweeps[i + 1..].iter().map(move |other| (one, other)));
        pairs
            .filter(|((_, first), (_, second))| first.may_come_within(second, NEGATIVE_DISTANCE_M))
            .filter_map(|((i, first), (j, second))| Self::detect_pair(&cores, [*i, *j], [first, second]))
            .collect()
    }
}

/// The scene with agents of unrecorded size at half their nominal size: boxes of nominal size would overlap where no
/// agents touch.
fn with_cores(scene: &Scene) -> Cow<'_, Scene> {
    if scene.tracks.iter().all(|track| track.extent.is_some()) {
        return Cow::Borrowed(scene);
    }
    let core = |track: &Track| Track { extent: Some(core_or_recorded(track)), ..track.clone() };
    Cow::Owned(Scene { tracks: scene.tracks.iter().map(core).collect(), ..scene.clone() })
}

/// The recorded size of an agent, or half the nominal one: boxes of nominal size would overlap where no agents touch.
pub(super) fn core_or_recorded(track: &Track) -> Extent {
    let Extent { length_m, width_m } = track.extent_or_nominal();
    track.extent.unwrap_or(Extent { length_m: length_m / 2.0, width_m: width_m / 2.0 })
}
