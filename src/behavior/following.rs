//! Which agents are in the way of a vehicle in its lane, and how far ahead?

use super::footprint::Footprint;
use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Scene, State};
use std::f64::consts::FRAC_PI_4;

/// An agent in a lane points along it within this, radians.
const ALONG_RAD: f64 = FRAC_PI_4;
/// The headway to which a vehicle falls back that somebody has cut off, within which time, seconds, and the largest
/// difference of speeds at which it does, m/s.
const FOLLOWS_S: f64 = 0.9;
const OPENS_S: f64 = 3.0;
const MOST_OPENS_MPS: f64 = 2.0;

/// How much slower than the one ahead, which is as far as this, a vehicle with this speed drives until it has fallen
/// back to the usual distance, m/s.
pub(crate) fn opens_mps(speed_mps: f64, gap_m: f64) -> f64 {
    ((FOLLOWS_S * speed_mps - gap_m) / OPENS_S).clamp(0.0, MOST_OPENS_MPS)
}

/// A vehicle and the lane that it keeps.
pub(super) struct Follower<'a> {
    scene: &'a Scene,
    agent_idx: usize,
    pub(super) lane: KeptLane,
}

/// An agent ahead in that lane at some timestep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ahead {
    pub(super) agent_idx: usize,
    /// Along the lane from the follower's front to the nearest part of the other, meters.
    pub(super) gap_m: f64,
    /// Speeds along the lane of the follower and of the other, m/s.
    pub(super) own_mps: f64,
    pub(super) their_mps: f64,
}

impl<'a> Follower<'a> {
    /// The agent with the lane that it keeps, among other vehicles. `None` if it is in no lane at present.
    pub(super) fn of(scene: &'a Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let lane = KeptLane::of(scene, lanes, agent_idx)?;
        Some(Self { scene, agent_idx, lane })
    }

    /// As [`Self::of`], with the lane predicted from the past alone.
    pub(super) fn as_observed(scene: &'a Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let lane = KeptLane::as_observed(scene, lanes, agent_idx)?;
        Some(Self { scene, agent_idx, lane })
    }

    /// Its speed, m/s; 0 if it is not tracked.
    pub(super) fn speed_mps(&self, timestep: usize) -> f64 {
        self.state(self.agent_idx, timestep).map_or(0.0, State::speed_mps)
    }

    /// The agents ahead in the lane at `timestep` within `reach_m` that are in the follower's way, nearest first.
    /// Because two may drive beside each other in one lane, the boxes must overlap across it by at least half the width
    /// of the narrower one. Empty if the follower itself is not in the lane.
    pub(super) fn ahead(&self, timestep: usize, reach_m: f64) -> Vec<Ahead> {
        let Some(own) = self.state_in_lane(self.agent_idx, timestep) else { return Vec::new() };
        let Some(place) = self.lane.project(own.position) else { return Vec::new() };
        let extent = self.scene.tracks[self.agent_idx].extent_or_nominal();
        let (half_length_m, half_width_m) = (extent.length_m / 2.0, extent.width_m / 2.0);
        let mut found: Vec<(f64, Ahead)> = Vec::new();
        for agent_idx in (0..self.scene.tracks.len()).filter(|idx| *idx != self.agent_idx) {
            let track = &self.scene.tracks[agent_idx];
            let nearest_m = reach_m + half_length_m + track.extent_or_nominal().length_m;
            let is_near = |state: &State| state.position.distance(own.position) <= nearest_m;
            let is_eligible = track.class.is_motorized() && self.state(agent_idx, timestep).is_some_and(is_near);
            let Some(state) = is_eligible.then(|| self.state_in_lane(agent_idx, timestep)).flatten() else { continue };
            let Some(theirs) = self.lane.project(state.position) else { continue };
            let along = Vec2::from_angle(theirs.heading_rad);
            let way_m = theirs.station_m - place.station_m;
            let body = Footprint::new(&track.footprint(state));
            let gap_m = way_m - half_length_m - body.half_extent_m(along);
            // Half of both widths, less the required overlap of half the narrower one, is half of the wider one.
            let their_half_m = body.half_extent_m(along.left());
            let is_in_way = (theirs.offset_m - place.offset_m).abs() <= half_width_m.max(their_half_m);
            if way_m > 0.0 && gap_m <= reach_m && is_in_way {
                let own_mps = own.velocity.dot(Vec2::from_angle(place.heading_rad));
                found.push((way_m, Ahead { agent_idx, gap_m, own_mps, their_mps: state.velocity.dot(along) }));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.into_iter().map(|(_, ahead)| ahead).collect()
    }

    /// The agent's state, if its center is in the lane then and it heads along it.
    pub(super) fn state_in_lane(&self, agent_idx: usize, timestep: usize) -> Option<&'a State> {
        let state = self.state(agent_idx, timestep)?;
        let heading_rad = self.lane.project(state.position)?.heading_rad;
        let is_along = angle_difference(state.heading_rad, heading_rad).abs() < ALONG_RAD;
        (is_along && self.lane.holds(state.position)).then_some(state)
    }

    fn state(&self, agent_idx: usize, timestep: usize) -> Option<&'a State> {
        self.scene.state(agent_idx, timestep).filter(|state| state.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Extent;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn boxes_overlap_across_the_lane_by_half_the_width_of_the_narrower_one() {
        let is_ahead = |width_m: f64, offset_m: f64| {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(12.0, offset_m, 0.0, 10.0)];
            let mut scene = scene(&drives);
            scene.tracks[1].extent = Some(Extent { length_m: 8.0, width_m });
            let lanes = SceneLanes::new(&scene.lanes);
            let follower = Follower::of(&scene, &lanes, 0).unwrap();
            !follower.ahead(scene.current_timestep(), 50.0).is_empty()
        };
        // Behind a truck, beside a motorcycle: the follower is 1.8 m wide.
        assert_eq!([1.2, 1.4].map(|offset_m| is_ahead(2.6, offset_m)), [true, false]);
        assert_eq!([0.8, 1.0].map(|offset_m| is_ahead(0.8, -offset_m)), [true, false]);
    }
}
