//! The subject of an event: the vehicle to which it happens.
//!
//! A driving function under test takes the place of the subject. It is therefore never the agent that causes the
//! danger, but the one that must cope with it: the vehicle that is cut off, not the one that cuts in. If the behavior
//! is a task that the vehicle has to solve itself, such as a turn or a stop line, that vehicle is the subject.

use super::driven_path::DrivenPath;
use super::footprint::Footprint;
use super::{BehaviorEntry, BehaviorEvent, EventLabel};
use crate::geometry::Vec2;
use crate::scene::Scene;
use std::f64::consts::FRAC_PI_2;

/// Agents farther than this from the place, at their speed, have nothing to do with the event, seconds.
const REACH_S: f64 = 5.0;
/// Agents slower than this do not come upon others, m/s.
const STANDING_MPS: f64 = 0.5;

/// Which vehicle is the subject of a behavior's events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// The agent in this role.
    Role(&'static str),
    /// The first motorized agent of the two that has the other in its way: the follower, or the one that gets second to
    /// where their paths cross. If neither has, the first.
    WhoComesUpon,
    /// An agent without a role: the vehicle that first gets to the agent along its own path, if it does so within 5 s.
    WhoMeetsIt,
}

impl BehaviorEvent {
    /// Whether its subject is parked or, for a hard negative, any of its agents: traffic beside a parked vehicle is not
    /// an example of what nearly happened.
    pub fn is_of_parked(&self, scene: &Scene) -> bool {
        let is_parked = |agent_idx: usize| scene.tracks[agent_idx].is_parked();
        match self.label {
            EventLabel::Positive => self.subject_idx(scene).is_some_and(is_parked),
            EventLabel::Negative => self.roles.tracks().filter_map(|id| scene.track_idx(id)).any(is_parked),
        }
    }

    /// The index of the subject among the tracks of `scene`. `None` if there is none.
    pub fn subject_idx(&self, scene: &Scene) -> Option<usize> {
        let agents: Vec<usize> = self.roles.tracks().filter_map(|id| scene.track_idx(id)).collect();
        let is_motorized = |agent_idx: &usize| {
            let track = &scene.tracks[*agent_idx];
            track.class.is_motorized() && !track.is_parked()
        };
        match BehaviorEntry::of(&self.behavior)?.subject {
            Subject::Role(role) => scene.track_idx(self.track(role)?),
            Subject::WhoComesUpon => {
                let [first, second] = agents[..] else { return None };
                let pairs = [[first, second], [second, first]].into_iter().filter(|[own, _]| is_motorized(own));
                let comes_upon = |[own, other]: &[usize; 2]| {
                    let is_in_way = |t: &usize| arrival_s(scene, [*own, *other], *t).is_some();
                    (0..=self.end_timestep).find(is_in_way).unwrap_or(usize::MAX)
                };
                pairs.min_by_key(comes_upon).map(|[own, _]| own)
            }
            Subject::WhoMeetsIt => {
                let agent_idx = *agents.first()?;
                let is_there = |idx: &usize| scene.state(*idx, scene.current_timestep()).is_some();
                let others = (0..scene.tracks.len()).filter(|idx| *idx != agent_idx);
                let soonest_s = |own: usize| {
                    let timesteps = self.start_timestep..=self.end_timestep;
                    let times = timesteps.filter_map(|t| arrival_s(scene, [own, agent_idx], t));
                    times.reduce(f64::min).filter(|time_s| *time_s <= REACH_S).map(|time_s| (own, time_s))
                };
                let met = others.filter(|idx| is_motorized(idx) && is_there(idx)).filter_map(soonest_s);
                met.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(own, _)| own)
            }
        }
    }
}

/// The time that `own` takes to `other`, which is in its way at `timestep`, along the path that it drives, at its speed
/// at that time, seconds. `None` if the other is not ahead of it or not in the strip that it covers.
fn arrival_s(scene: &Scene, [own, other]: [usize; 2], timestep: usize) -> Option<f64> {
    let at = |agent_idx: usize| scene.state(agent_idx, timestep).filter(|state| state.is_finite());
    let (ours, theirs) = (at(own)?, at(other)?);
    let speed_mps = Some(ours.speed_mps()).filter(|speed_mps| *speed_mps >= STANDING_MPS)?;
    let [own, other] = [own, other].map(|agent_idx| &scene.tracks[agent_idx]);
    let path = DrivenPath::from(own, timestep)?;
    let (start, place) = (path.project(ours.position)?, path.project(theirs.position)?);
    let body = other.footprint(theirs);
    let across = Vec2::from_angle(place.heading_rad + FRAC_PI_2);
    let reach_m = own.extent_or_nominal().width_m / 2.0 + Footprint::new(&body).half_extent_m(across);
    let is_in_way = place.station_m > start.station_m && place.offset_m.abs() < reach_m;
    is_in_way.then(|| path.gap_m(&body)).flatten().map(|gap_m| gap_m.max(0.0) / speed_mps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::TrackRole;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn who_is_parked_is_no_subject_and_makes_no_hard_negatives() {
        let mut scene = scene(&[
            Drive::straight(20.0, 0.0, 0.0, 0.0),
            Drive::straight(0.0, 0.0, 0.0, 15.0),
            Drive::straight(0.0, 3.5, 0.0, 15.0),
        ]);
        let event = |behavior: &str, label, agents: [usize; 2]| {
            let entry = BehaviorEntry::of(behavior).unwrap();
            BehaviorEvent::new((entry.id, entry.roles), &scene, label, &agents, 4..=11)
        };
        let [positive, negative] = [EventLabel::Positive, EventLabel::Negative];
        let hits = [event("collision", positive, [0, 1]), event("collision", positive, [1, 0])];
        let others = [event("cut_in", positive, [0, 1]), event("cut_in", negative, [1, 0])];
        let of_driving = event("cut_in", negative, [1, 2]);
        assert!([&hits[..], &others].concat().iter().all(|event| !event.is_of_parked(&scene)));
        scene.tracks[0].role = TrackRole::Parked;
        assert!(hits.iter().all(|event| event.subject_idx(&scene) == Some(1) && !event.is_of_parked(&scene)));
        assert!(others.iter().all(|event| event.is_of_parked(&scene)) && !of_driving.is_of_parked(&scene));
    }
}
