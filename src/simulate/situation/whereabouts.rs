//! Is an agent on the map, on the road, and where traffic is seen?

use super::Situation;
use crate::behavior::footprint::Bounds;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Lane, LaneGraph, LaneId, State};
use crate::simulate::World;

/// Agents farther than this from the middle of every lane, meters, have left the map.
const OFF_MAP_M: f64 = 10.0;
/// Agents this close to the middle of a lane, meters, are in it.
const IN_LANE_M: f64 = 2.0;

impl Situation {
    /// How far off the road an ego that starts on it is, meters. `None` where the map does not show the road.
    pub(in crate::simulate) fn ego_off_road_m(&self, state: &State) -> Option<f64> {
        self.starts_on_road.then(|| self.off_road_m(state))?
    }

    pub(in crate::simulate) fn off_road_m(&self, state: &State) -> Option<f64> {
        (!self.scene.lanes.is_empty()).then(|| self.road.distance_m(state.position))
    }

    /// The smallest angle between the heading of a state and a lane that it is in, radians. `None` outside of lanes.
    pub(in crate::simulate) fn across_lanes_rad(&self, state: &State) -> Option<f64> {
        let lanes = self.scene.lanes.lanes().iter().zip(&self.lane_bounds);
        let near = lanes.filter(|(_, bounds)| bounds.is_some_and(|bounds| bounds.contains(state.position, IN_LANE_M)));
        let angles = near.filter_map(|(lane, _)| {
            let place = lane.centerline.project(state.position).filter(|place| place.offset_m.abs() <= IN_LANE_M)?;
            Some(angle_difference(state.heading_rad, place.heading_rad).abs())
        });
        angles.reduce(f64::min)
    }

    pub(super) fn is_on_map(&self, state: &State) -> bool {
        let mut lanes = self.scene.lanes.lanes().iter().zip(&self.lane_bounds);
        self.scene.lanes.is_empty() || lanes.any(|(lane, bounds)| is_near(lane, *bounds, state.position, OFF_MAP_M))
    }

    /// Whether an agent was on the map at present and is off it now.
    pub(in crate::simulate) fn has_left_map(&self, agent_idx: usize, state: &State) -> bool {
        self.starts_on_map[agent_idx] && !self.is_on_map(state)
    }

    /// Whether an agent has gone since an earlier timestep where no traffic of the place is seen. Agents of the event
    /// may do so until it has happened, and are gone then.
    pub(in crate::simulate) fn goes_out_of_sight(&self, world: &World, agent_idx: usize, since: usize) -> bool {
        let is_out = |timestep: usize| {
            let state = world.state(agent_idx, timestep);
            state.is_some_and(|state| self.arrivals.is_out_of_sight(self, &state))
        };
        let now = world.now();
        let since = match self.roles.contains(&agent_idx) {
            true if now <= world.plan_ends => return false,
            true => self.scene.current_timestep(),
            false => since,
        };
        is_out(now) && !is_out(since)
    }
}

/// The lanes whose middle comes this close to any of these points.
pub(super) fn near(lanes: &LaneGraph, bounds: &[Option<Bounds>], points: &[Vec2], within_m: f64) -> Vec<LaneId> {
    let is_near_one =
        |(lane, bounds): &(&Lane, &Option<Bounds>)| points.iter().any(|at| is_near(lane, **bounds, *at, within_m));
    lanes.lanes().iter().zip(bounds).filter(is_near_one).map(|(lane, _)| lane.id).collect()
}

/// The rectangle around the middle of each lane, in their order.
pub(super) fn bounds(lanes: &LaneGraph) -> Vec<Option<Bounds>> {
    lanes.lanes().iter().map(|lane| Bounds::around(lane.centerline.0.iter().copied())).collect()
}

fn is_near(lane: &Lane, bounds: Option<Bounds>, at: Vec2, within_m: f64) -> bool {
    bounds.is_some_and(|bounds| bounds.contains(at, within_m))
        && lane.centerline.project(at).is_some_and(|place| place.offset_m.abs() <= within_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Trajectory;
    use crate::simulate::testing::{record, situation};

    #[test]
    fn who_leaves_the_map_is_gone_and_who_was_never_on_it_stays() {
        let mut record = record();
        let ego_idx = record.subject_idx().unwrap();
        let far = |state: State| State { position: state.position + Vec2::new(0.0, 200.0), ..state };
        let stray = (0..record.scenario.scene.tracks.len()).find(|idx| *idx != ego_idx).unwrap();
        let before = situation(&record);
        let now = |situation: &Situation, idx: usize| situation.start(1).present(idx).unwrap();
        assert!(
            !before.has_left_map(stray, &now(&before, stray)) && before.has_left_map(stray, &far(now(&before, stray)))
        );
        let track = &mut record.scenario.scene.tracks[stray];
        let moved = track.trajectory.entries().iter().map(|state| state.map(far)).collect();
        track.trajectory = Trajectory::new(moved);
        let after = situation(&record);
        assert!(!after.has_left_map(stray, &now(&after, stray)));
        assert!(after.ego_off_road_m(&far(now(&after, ego_idx))).unwrap() > 10.0);
    }
}
