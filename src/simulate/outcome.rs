//! How does a drive end?

use super::situation::Situation;
use super::world::World;
use crate::behavior::footprint::Footprint;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::scene::{State, TrackId};
use crate::settings::named;
use serde::{Deserialize, Serialize};

/// The end of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The ego came through to the horizon, or to the end of the map.
    Survived,
    /// It touched another agent.
    Hit,
    /// Its center left the road.
    LeftRoad,
    /// It stood for the last four seconds with 10 m of free road ahead of it.
    StoppedDead,
    /// Its planner did not answer in time.
    TimedOut,
    /// Its planner died, or its answer is no motion of a vehicle.
    PlannerFailed,
    /// The model had no future for the others; no fault of the ego.
    NotSampled,
}

named! { Outcome {
    Survived = "survived", Hit = "hit", LeftRoad = "left_road", StoppedDead = "stopped_dead", TimedOut = "timed_out",
    PlannerFailed = "planner_failed", NotSampled = "not_sampled",
} }

impl Outcome {
    /// Whether the driver of the ego is to blame.
    pub const fn is_failure(self) -> bool {
        !matches!(self, Self::Survived | Self::NotSampled)
    }
}

/// The side of the ego that is touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Ahead.
    Front,
    /// Left or right.
    Flank,
    /// Behind.
    Rear,
}

named! { Side { Front = "front", Flank = "flank", Rear = "rear" } }

/// The first contact of the ego with another agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// The other agent.
    pub track: TrackId,
    /// The side of the ego that is touched.
    pub side: Side,
    /// The speed of one relative to the other, m/s.
    pub relative_mps: f64,
}

/// The first contact of the ego at present.
pub(super) fn contact(situation: &Situation, world: &World) -> Option<Contact> {
    let ego_idx = situation.ego_idx;
    let ego = world.present(ego_idx)?;
    let others = (0..world.n_tracks()).filter(|agent_idx| situation.can_touch(*agent_idx));
    let mut touching = others.filter_map(|agent_idx| {
        let state = world.present(agent_idx)?;
        situation.overlap([(ego_idx, &ego), (agent_idx, &state)]).then_some((agent_idx, state))
    });
    let (agent_idx, other) = touching.next()?;
    let body = situation.body(ego_idx, &ego);
    let place = (other.position - ego.position).rotated(-ego.heading_rad);
    let (along, across) = (place.x / body.length_m, place.y / body.width_m);
    let side = match () {
        () if along.abs() < across.abs() => Side::Flank,
        () if along > 0.0 => Side::Front,
        () => Side::Rear,
    };
    let relative_mps = (other.velocity - ego.velocity).norm();
    Some(Contact { track: situation.scene.tracks[agent_idx].id.clone(), side, relative_mps })
}

/// The shortest time to collision of the ego with any agent now, if both keep their velocities, seconds.
pub(super) fn ttc_s(situation: &Situation, world: &World) -> Option<f64> {
    let ego_idx = situation.ego_idx;
    let ego = world.present(ego_idx)?;
    let body = |agent_idx: usize, state: &State| Footprint::new(&situation.body(agent_idx, state));
    let own = body(ego_idx, &ego);
    let others = (0..world.n_tracks()).filter(|agent_idx| situation.can_touch(*agent_idx));
    let times = others.filter_map(|agent_idx| {
        let other = world.present(agent_idx)?;
        time_to_collision_s(&own, ego.velocity, &body(agent_idx, &other), other.velocity)
    });
    times.reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::simulate::testing::{record, situation};
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn contacts_have_the_side_of_the_ego_and_the_speed_of_one_seen_from_the_other() {
        let situation = situation(&record());
        let (ego_idx, other_idx, heading_rad) = (situation.ego_idx, situation.planned[0], 0.3);
        let contact_with = |ahead_m: f64, left_m: f64, turned_rad: f64| {
            let state = |position: Vec2, heading_rad: f64| State {
                position: position.rotated(0.3),
                heading_rad,
                velocity: Vec2::from_angle(heading_rad) * 10.0,
            };
            let states = [
                (ego_idx, state(Vec2::ZERO, heading_rad)),
                (other_idx, state(Vec2::new(ahead_m, left_m), heading_rad + turned_rad)),
            ];
            let at = |idx: usize| [states.iter().find(|(of, _)| *of == idx).map(|(_, state)| *state)];
            let tracks: Vec<[Option<State>; 1]> = (0..situation.scene.tracks.len()).map(at).collect();
            let world = World::new("s", 0, 0, tracks.iter().map(<[_; 1]>::as_slice));
            contact(&situation, &world).map(|contact| (contact.side, (contact.relative_mps * 100.0).round()))
        };
        // As fast ahead of it and behind, from its left, head on, and apart.
        assert_eq!(contact_with(3.0, 0.0, 0.0), Some((Side::Front, 0.0)));
        assert_eq!(contact_with(-3.0, 0.0, 0.0), Some((Side::Rear, 0.0)));
        assert_eq!(contact_with(0.0, 1.5, -FRAC_PI_2), Some((Side::Flank, 1414.0)));
        assert_eq!(contact_with(3.0, 0.0, PI), Some((Side::Front, 2000.0)));
        assert_eq!(contact_with(30.0, 0.0, PI), None);
    }
}
