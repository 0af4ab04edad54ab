//! Conflicts of the paths of two agents: one comes into the way of another from beside it. When is it out of the way
//! again, and when does the other get there?

use super::footprint::Footprint;
use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use super::speed_profile::smoothed_accelerations_mps2;
use super::swept_boxes::SweptBoxes;
use crate::geometry::Vec2;
use crate::scene::{Extent, Scene, State, Track};
use std::f64::consts::FRAC_PI_6;

/// How long before the first agent gets into its way the other may begin to brake, seconds.
const FORESIGHT_S: f64 = 1.0;
/// An agent in the lane of another whose heading is within this of the lane's direction follows it, radians.
const FOLLOWING_RAD: f64 = FRAC_PI_6;
/// Spacing of the places along a lane at which a box is tested, meters, and the farthest of them.
const SPACING_M: f64 = 0.5;
const FARTHEST_M: f64 = 100.0;
/// Agents below this speed arrive at no time, m/s.
const STANDING_MPS: f64 = 0.5;
/// The window over which decelerations are smoothed, seconds.
const SMOOTHING_S: f64 = 0.5;

/// An agent and the way that it keeps: its lane, at its present distance from the center line.
pub(super) struct Course<'a> {
    pub(super) track: &'a Track,
    pub(super) lane: KeptLane,
    pub(super) sweep: SweptBoxes,
    extent: Extent,
    /// Its highest speed.
    fastest_mps: f64,
    /// Its place beside the center line, meters; positive to the left.
    offset_m: f64,
}

/// One agent comes into the way of another, from beside it, and leaves it or turns into it.
///
/// It is in the way at a timestep if its box overlaps the strip that the other covers on its way, and its heading
/// differs from the direction of that way by at least 30 degrees. The *conflict zone* is the ground that its boxes
/// cover at these timesteps.
pub(super) struct Conflict {
    /// The first timestep at which it is in the way, and the first after that at which it is not.
    pub(super) enters: usize,
    pub(super) leaves: usize,
    /// The first timestep at which the box of the other is in the conflict zone; `None` if that is not recorded.
    pub(super) arrives: Option<usize>,
    /// Whether it continues in the lane of the other.
    pub(super) merges: bool,
    zone: Vec<Footprint>,
}

impl<'a> Course<'a> {
    /// The agent with the lane that it keeps. `None` if it is in no lane at present.
    pub(super) fn of(scene: &'a Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let lane = KeptLane::of(scene, lanes, agent_idx)?;
        let track = &scene.tracks[agent_idx];
        let present = track.trajectory.get(scene.current_timestep())?;
        let offset_m = lane.project(present.position)?.offset_m;
        let speeds =
            track.trajectory.valid().filter(|(_, state)| state.is_finite()).map(|(_, state)| state.speed_mps());
        let fastest_mps = speeds.fold(0.0, f64::max);
        let (sweep, extent) = (SweptBoxes::new(track)?, track.extent_or_nominal());
        Some(Self { track, lane, sweep, extent, fastest_mps, offset_m })
    }

    pub(super) fn state(&self, timestep: usize) -> Option<&State> {
        self.track.trajectory.get(timestep).filter(|state| state.is_finite())
    }

    /// Whether `body` overlaps the strip that the agent covers on its way, and whether it is along that way.
    fn meets(&self, body: &Footprint) -> (bool, bool) {
        let farthest_m = self.offset_m.abs() + self.extent.width_m / 2.0 + body.radius_m;
        if !self.lane.may_come_within(body.center, farthest_m) {
            return (false, false);
        }
        let Some(place) = self.lane.project(body.center) else { return (false, false) };
        let along = Vec2::from_angle(place.heading_rad);
        let reach_m = self.extent.width_m / 2.0 + body.half_extent_m(along.left());
        ((place.offset_m - self.offset_m).abs() < reach_m, body.forward.dot(along) > FOLLOWING_RAD.cos())
    }

    /// The distance along the lane from the place of the agent at `timestep` to where its box first overlaps one of
    /// `zone`, meters. `None` if it is not tracked then, or does not get there.
    fn way_m(&self, timestep: usize, zone: &[Footprint]) -> Option<f64> {
        let start_m = self.lane.project(self.state(timestep)?.position)?.station_m;
        let Extent { length_m, width_m } = self.extent;
        let mut steps = (0..=(FARTHEST_M / SPACING_M) as usize).map(|step| step as f64 * SPACING_M);
        steps.find(|way_m| {
            let Some(center) = self.lane.beside(start_m + way_m, self.offset_m) else { return false };
            let Some(place) = self.lane.project(center) else { return false };
            let body = Footprint::along(center, Vec2::from_angle(place.heading_rad), [length_m, width_m]);
            zone.iter().any(|other| other.overlaps(&body))
        })
    }

    /// Its strongest deceleration from `timestep` on, m/s²: the largest slope of the speed over half a second. 0 if it
    /// only accelerates; `None` if it is not tracked for long enough.
    pub(super) fn strongest_deceleration_mps2(&self, scene: &Scene, timestep: usize) -> Option<f64> {
        let present = scene.current_timestep();
        let all = smoothed_accelerations_mps2(&self.track.trajectory, present, scene.dt_s, SMOOTHING_S);
        all.get(timestep..)?.iter().flatten().map(|mps2| mps2.min(0.0).abs()).reduce(f64::max)
    }
}

impl Conflict {
    /// The conflict in which `first` gets into the way of `other` before `other` gets there. `None` if there is none,
    /// if it begins before or ends after the states of `first`, if the two touch, or if `other` certainly does not get
    /// there within `within_s` after its last state.
    pub(super) fn between(first: &Course<'_>, other: &Course<'_>, within_s: f64) -> Option<Self> {
        let is_near = first.sweep.may_come_within(&other.sweep, other.fastest_mps * within_s);
        if !is_near || first.fastest_mps < STANDING_MPS {
            return None;
        }
        let n_timesteps = first.track.trajectory.n_timesteps();
        let blocks = |timestep: usize| first.sweep.at(timestep).map(|body| other.meets(body) == (true, false));
        let enters = (1..n_timesteps).find(|t| blocks(*t) == Some(true) && blocks(t - 1) == Some(false))?;
        let leaves = (enters..n_timesteps).find(|t| blocks(*t) != Some(true))?;
        let (merges, _) = other.meets(first.sweep.at(leaves)?);
        let zone: Vec<Footprint> = (enters..leaves).filter_map(|t| first.sweep.at(t).copied()).collect();
        let is_there = |t: &usize| other.sweep.at(*t).is_some_and(|body| zone.iter().any(|own| own.overlaps(body)));
        let arrives = (0..n_timesteps).find(is_there);
        let is_first = arrives.is_none_or(|arrives| arrives >= enters);
        let touches = || first.sweep.both_at(&other.sweep, 0..n_timesteps).any(|(_, own, others)| own.overlaps(others));
        (is_first && !touches()).then_some(Self { enters, leaves, arrives, merges, zone })
    }

    /// The post-encroachment time, seconds: from when the first agent is out of the way to when the other enters the
    /// conflict zone, negative if it does so earlier. If that is not recorded, the time that the other would take from
    /// its place when the first is out of the way, at its speed at that time. `None` if it stands or does not get
    /// there.
    pub(super) fn pet_s(&self, other: &Course<'_>, dt_s: f64) -> Option<f64> {
        match self.arrives {
            Some(arrives) => Some((arrives as f64 - self.leaves as f64) * dt_s),
            None => self.arrival_s(other, self.leaves),
        }
    }

    /// The time that the other takes to the conflict zone from its place at `timestep`, at its speed at that time,
    /// seconds. `None` if it stands or does not get there.
    pub(super) fn arrival_s(&self, other: &Course<'_>, timestep: usize) -> Option<f64> {
        let speed_mps = other.state(timestep)?.speed_mps();
        (speed_mps >= STANDING_MPS).then(|| other.way_m(timestep, &self.zone)).flatten().map(|way_m| way_m / speed_mps)
    }

    /// The post-encroachment time if the other kept the speed of a second before the first gets into its way, when it
    /// may begin to brake for it, seconds. `None` as for [`Self::arrival_s`].
    pub(super) fn pet_at_kept_speed_s(&self, other: &Course<'_>, dt_s: f64) -> Option<f64> {
        let before = self.foreseen(dt_s);
        let taken_s = (self.leaves - before) as f64 * dt_s;
        self.arrival_s(other, before).map(|arrival_s| arrival_s - taken_s)
    }

    /// The timestep from which the other may brake for the first.
    pub(super) fn foreseen(&self, dt_s: f64) -> usize {
        self.enters.saturating_sub((FORESIGHT_S / dt_s).round() as usize)
    }

    /// The last timestep of the conflict: the other's arrival, if recorded, or else when the first is out of the way.
    pub(super) fn last_timestep(&self) -> usize {
        self.arrives.map_or(self.leaves, |arrives| arrives.max(self.leaves))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::{going_on, lane_graph};
    use crate::scene::testing::Drive;
    use std::f64::consts::FRAC_PI_2;

    /// Two lanes that cross at right angles, at the origin.
    fn crossing(drives: &[Drive]) -> Scene {
        let lanes = "lanes = [
            { id = 1, centerline = [[-100, 0], [100, 0]], width_m = 3.5 },
            { id = 2, centerline = [[0, -100], [0, 100]], width_m = 3.5 },
        ]";
        going_on(drives, lane_graph(lanes))
    }

    fn conflict(scene: &Scene, first: usize, other: usize) -> (Option<Conflict>, Option<f64>) {
        let lanes = SceneLanes::new(&scene.lanes);
        let [first, other] = [first, other].map(|agent_idx| Course::of(scene, &lanes, agent_idx).expect("in a lane"));
        let conflict = Conflict::between(&first, &other, 10.0);
        let pet_s = conflict.as_ref().and_then(|conflict| conflict.pet_s(&other, scene.dt_s));
        (conflict, pet_s)
    }

    /// Cars of 4.5 by 1.8 m, at 10 and 5 m/s: strips of ±0.9 m cross, so boxes reach the zone 3.15 m before its middle.
    #[test]
    fn the_post_encroachment_time_of_two_that_cross() {
        let scene = crossing(&[Drive::straight(0.0, -12.0, FRAC_PI_2, 10.0), Drive::straight(-13.0, 0.0, 0.0, 5.0)]);
        // The first is in the way from y > -3.15 m, at 0.885 s, to y < 3.15 m, at 1.515 s; the other arrives at
        // x > -3.15 m, at 1.97 s.
        let (found, pet_s) = conflict(&scene, 0, 1);
        let found = found.expect("a conflict");
        assert_eq!((found.enters, found.leaves, found.arrives, found.merges), (9, 16, Some(20), false));
        assert!((pet_s.unwrap() - 0.4).abs() < 1e-9);
        // The other one is not the first.
        assert!(conflict(&scene, 1, 0).0.is_none());
    }

    #[test]
    fn arrivals_that_are_not_recorded_are_expected_at_the_speed_of_the_last_moment() {
        // At 16 timesteps the other is at x = -38 + 1.6 * 5 = -30 m: 26.85 m, tried every half meter, take 5.4 s.
        let scene = crossing(&[Drive::straight(0.0, -12.0, FRAC_PI_2, 10.0), Drive::straight(-38.0, 0.0, 0.0, 5.0)]);
        let (found, pet_s) = conflict(&scene, 0, 1);
        assert_eq!(found.map(|found| (found.arrives, found.last_timestep())), Some((None, 16)));
        assert!((pet_s.unwrap() - 27.0 / 5.0).abs() < 1e-9, "{pet_s:?}");
        // An agent that always stands does not get there.
        let scene = crossing(&[Drive::straight(0.0, -12.0, FRAC_PI_2, 10.0), Drive::straight(-38.0, 0.0, 0.0, 0.0)]);
        assert!(conflict(&scene, 0, 1).0.is_none());
    }

    #[test]
    fn who_collides_stays_or_was_there_has_no_conflict() {
        for drives in [
            // They meet in the middle.
            [Drive::straight(0.0, -12.0, FRAC_PI_2, 10.0), Drive::straight(-13.0, 0.0, 0.0, 10.0)],
            // The first stands in the way from the start.
            [Drive::straight(0.0, -1.0, FRAC_PI_2, 0.0), Drive::straight(-40.0, 0.0, 0.0, 5.0)],
            // It follows in the same lane.
            [Drive::straight(-20.0, 0.0, 0.0, 10.0), Drive::straight(-30.0, 0.0, 0.0, 10.0)],
            // The scene ends before it is through.
            [Drive::straight(0.0, -6.0, FRAC_PI_2, 1.0), Drive::straight(-40.0, 0.0, 0.0, 5.0)],
        ] {
            assert!(conflict(&crossing(&drives), 0, 1).0.is_none(), "{drives:?}");
        }
    }
}
