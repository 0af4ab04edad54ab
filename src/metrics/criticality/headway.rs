//! Time headway: until a follower is where its leader is now.

use super::agent::MovingAgent;
use crate::behavior::driven_path::DrivenPath;
use crate::behavior::footprint::Footprint;
use crate::geometry::{Vec2, angle_difference};
use crate::metrics::sample_group::future;
use crate::scene::Scene;
use std::f64::consts::FRAC_PI_4;

/// Speeds below this count as standing, m/s.
const STANDING_MPS: f64 = 0.1;

/// The least time headway of either of two agents behind the other, seconds; `None` if neither follows.
pub(super) fn min_headway_s(scene: &Scene, [first, second]: [&MovingAgent; 2]) -> Option<f64> {
    let at = |timestep: usize| [headway_s(scene, first, second, timestep), headway_s(scene, second, first, timestep)];
    future(scene).flat_map(at).flatten().reduce(f64::min)
}

/// The time headway of `follower` behind `leader`, seconds; `None` if it does not follow it at that timestep.
fn headway_s(scene: &Scene, follower: &MovingAgent, leader: &MovingAgent, timestep: usize) -> Option<f64> {
    let speed_mps = follower.velocity(timestep).map(Vec2::norm).filter(|speed_mps| *speed_mps > STANDING_MPS)?;
    let track = &scene.tracks[follower.agent_idx];
    let leading = &scene.tracks[leader.agent_idx];
    let state = leading.trajectory.get(timestep).filter(|state| state.is_finite())?;
    let own = track.trajectory.get(timestep)?;
    // A cheap test of the order of the two, before the projection onto a path.
    if (state.position - own.position).dot(Vec2::from_angle(own.heading_rad)) <= 0.0 {
        return None;
    }
    let path = DrivenPath::from(track, timestep)?;
    let place = path.project(state.position)?;
    let body = leading.footprint(state);
    let across = Vec2::from_angle(place.heading_rad + std::f64::consts::FRAC_PI_2);
    let reach_m = Footprint::new(&body).half_extent_m(across) + track.extent_or_nominal().width_m / 2.0;
    let is_on_path = place.offset_m.abs() < reach_m;
    let is_same_way = angle_difference(state.heading_rad, place.heading_rad).abs() <= FRAC_PI_4;
    let gap_m = path.gap_m(&body).filter(|gap_m| is_on_path && is_same_way && *gap_m >= 0.0)?;
    Some(gap_m / speed_mps)
}
