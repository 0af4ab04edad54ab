//! Unprotected left turn: does one vehicle turn left across the lane of an oncoming one, shortly ahead of it?

use super::conflict::{Conflict, Course};
use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::turn::is_at_roundabout;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Scene, State};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_4, PI};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "unprotected_left_turn";
/// The vehicle that turns, and the one that comes toward it.
pub(super) const ROLES: &[&str] = &["turner", "oncoming"];
/// Names of the parameters of its events, defined at [`UnprotectedLeftTurn`].
pub(super) const PARAMETERS: &[&str] =
    &["pet_s", "time_to_arrival_s", "turner_speed_mps", "oncoming_speed_mps", "max_deceleration_mps2"];

/// How far lanes are followed before and after the conflict zone to find their directions, meters.
const ARM_M: f64 = 25.0;
/// Lanes from opposite arms differ from opposite directions by less than this, and the turner heads along its lane
/// within this, radians.
const ALONG_RAD: f64 = FRAC_PI_4;
/// Smallest change of direction of the turner's lane to the left, radians.
const MIN_HEADING_CHANGE_RAD: f64 = FRAC_PI_4;
/// A change of direction beyond this is a U-turn, radians (150 degrees).
const U_TURN_RAD: f64 = 2.618;

/// A post-encroachment time that is too long by less than this is a hard negative, seconds.
const NEGATIVE_MORE_S: f64 = 2.0;

/// The oncoming vehicle drives at least this fast when the turner gets into its way, m/s: a slower one leaves the gap.
const MIN_SPEED_MPS: f64 = 5.0;

/// One vehicle (`turner`) turns left along its lane, across the lane of an oncoming one (`oncoming`) and shortly ahead
/// of it.
///
/// The lanes are those that the two turn out to keep: the one that each is in at present, with those that lead to it
/// and follow on. Their *conflict zone* is the ground that the turner's box covers while it overlaps the strip that the
/// oncoming vehicle covers on its way, at an angle of at least 30 degrees.
///
/// **Positive**: all of
///
/// - From 25 m before the conflict zone to 25 m behind it, the lane of the turner bends to the left by 45 to 150
///   degrees, and that of the oncoming vehicle by less than 45 degrees: it leads straight on or to the right. Where
///   they come from, the two lanes are opposite within 45 degrees.
/// - The turner enters the conflict zone before the oncoming vehicle, crosses the whole strip, and then heads along its
///   lane within 45 degrees. The boxes never touch.
/// - The oncoming vehicle drives at 5 m/s or more when the turner enters.
/// - The post-encroachment time is below 2 s: from when the turner has left the strip until the oncoming vehicle
///   enters the conflict zone; negative if that is earlier. If the oncoming vehicle does not get there while it is
///   tracked, the time is predicted from its place and speed when the turner has left.
///
/// The event *starts* when the turner enters the conflict zone and is *complete* when the oncoming vehicle does, or, if
/// that is not recorded, when the turner has left.
///
/// Recordings do not have the states of signals, and signs are not looked at: a turn is unprotected because the
/// crossing is shared within so short a time.
///
/// *What does not count*: oncoming vehicles that wait, turn left themselves, or come first; turns that the scene shows
/// only in part; roundabouts (lanes that lead back to themselves within 250 m, and those next to them); maps without
/// lanes.
///
/// **Negative**: the same with a post-encroachment time of up to 4 s.
///
/// Parameters: `pet_s`; when the turner enters, `time_to_arrival_s` (of the oncoming vehicle at the conflict zone, if
/// it kept its speed), `turner_speed_mps` and `oncoming_speed_mps`; `max_deceleration_mps2` (the hardest braking of the
/// oncoming vehicle from then on, over half a second; 0 if it does not brake).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct UnprotectedLeftTurn {
    /// A post-encroachment time below this is short, seconds. Default 2.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_pet_s: f64,
}

impl Default for UnprotectedLeftTurn {
    fn default() -> Self {
        Self { max_pet_s: 2.0 }
    }
}

impl UnprotectedLeftTurn {
    fn event(
        &self,
        scene: &Scene,
        lanes: &SceneLanes<'_>,
        turner: &Agent<'_>,
        oncoming: &Agent<'_>,
    ) -> Option<BehaviorEvent> {
        let negative_pet_s = self.max_pet_s + NEGATIVE_MORE_S;
        let conflict = Conflict::between(&turner.course, &oncoming.course, negative_pet_s)?;
        if conflict.merges {
            return None;
        }
        let speed_mps = |agent: &Agent<'_>| agent.course.state(conflict.enters).map(State::speed_mps);
        let oncoming_mps = speed_mps(oncoming).filter(|mps| *mps >= MIN_SPEED_MPS)?;
        let pet_s = conflict.pet_s(&oncoming.course, scene.dt_s).filter(|pet_s| *pet_s < negative_pet_s)?;
        if !Self::turns_across(lanes, turner, oncoming, &conflict)? {
            return None;
        }
        let label = if pet_s < self.max_pet_s { EventLabel::Positive } else { EventLabel::Negative };
        let timesteps = conflict.enters..=conflict.last_timestep();
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &[turner.agent_idx, oncoming.agent_idx], timesteps)
            .with("pet_s", pet_s)
            .with("time_to_arrival_s", conflict.arrival_s(&oncoming.course, conflict.enters))
            .with("turner_speed_mps", speed_mps(turner))
            .with("oncoming_speed_mps", oncoming_mps)
            .with("max_deceleration_mps2", oncoming.course.strongest_deceleration_mps2(scene, conflict.enters));
        Some(event)
    }

    /// Whether the lanes come from opposite arms and cross because the first leads to the left, and the turner follows
    /// its lane.
    fn turns_across(
        lanes: &SceneLanes<'_>,
        turner: &Agent<'_>,
        oncoming: &Agent<'_>,
        conflict: &Conflict,
    ) -> Option<bool> {
        let midway = turner.course.state(usize::midpoint(conflict.enters, conflict.leaves))?;
        let left = turner.course.state(conflict.leaves)?;
        let [own, theirs] = [&turner.course.lane, &oncoming.course.lane].map(|lane| Arms::of(lane, midway.position));
        let (own, theirs) = (own?, theirs?);
        let follows = angle_difference(turner.course.lane.project(left.position)?.heading_rad, left.heading_rad).abs();
        Some(
            (MIN_HEADING_CHANGE_RAD..U_TURN_RAD).contains(&own.turned_rad())
                && theirs.turned_rad() < MIN_HEADING_CHANGE_RAD
                && angle_difference(own.from_rad, theirs.from_rad).abs() > PI - ALONG_RAD
                && follows < ALONG_RAD
                && !is_at_roundabout(lanes, midway.position, midway.heading_rad),
        )
    }
}

/// An agent that may take part.
struct Agent<'a> {
    agent_idx: usize,
    course: Course<'a>,
}

/// The directions of a lane before and after a place, radians.
struct Arms {
    from_rad: f64,
    to_rad: f64,
}

impl Arms {
    fn of(lane: &KeptLane, place: Vec2) -> Option<Self> {
        let station_m = lane.project(place)?.station_m;
        Some(Self { from_rad: lane.heading_at(station_m - ARM_M)?, to_rad: lane.heading_at(station_m + ARM_M)? })
    }

    /// The change of direction, positive to the left.
    fn turned_rad(&self) -> f64 {
        angle_difference(self.to_rad, self.from_rad)
    }
}

impl Behavior for UnprotectedLeftTurn {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["pet_s", "oncoming_speed_mps"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |agents| self.turns_ahead(scene, agents))
    }

    /// At most one event for each ordered pair, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let admitted = (0..scene.tracks.len()).filter(|idx| scene.tracks[*idx].class.is_motorized());
        let agents: Vec<Agent<'_>> = admitted
            .filter_map(|agent_idx| Some(Agent { agent_idx, course: Course::of(scene, &lanes, agent_idx)? }))
            .collect();
        let others = |turner: &Agent<'_>| -> Vec<BehaviorEvent> {
            let others = agents.iter().filter(|other| other.agent_idx != turner.agent_idx);
            others.filter_map(|oncoming| self.event(scene, &lanes, turner, oncoming)).collect()
        };
        agents.iter().flat_map(others).collect()
    }
}
