//! The ways ahead of an agent in the map, and its possible positions on them.

use crate::behavior::kept_lane::extended;
use crate::behavior::lane_relation::SceneLanes;
use crate::geometry::{Polyline, Vec2, angle_difference};
use crate::scene::State;
use std::f64::consts::FRAC_PI_4;

/// An agent is only in lanes whose direction differs from its heading by less than this, radians.
const MAX_HEADING_DIFFERENCE_RAD: f64 = FRAC_PI_4;
/// The length of ways, meters: farther than any agent drives in a scene. And the largest number of ways.
const AHEAD_M: f64 = 150.0;
const N_WAYS: usize = 12;

/// A way, and the agent's place on it at present.
pub(super) struct Way {
    line: Polyline,
    station_m: f64,
    offset_m: f64,
}

impl Way {
    /// The agent's position after `driven_m` along the way, at its present offset from the line, and the direction of
    /// the way there.
    pub(super) fn place(&self, driven_m: f64) -> Option<(Vec2, Vec2)> {
        let on_line = self.line.point_at(self.station_m + driven_m)?;
        let along = Vec2::from_angle(self.line.project(on_line)?.heading_rad);
        Some((on_line + Vec2::new(-along.y, along.x) * self.offset_m, along))
    }
}

/// The ways ahead of an agent: along its lanes, with every choice at a fork; straight on if it is in no lane.
pub(super) fn ways(lanes: &SceneLanes<'_>, state: &State) -> Vec<Way> {
    let own = lanes
        .lanes_at(state.position)
        .filter(|(_, place)| angle_difference(place.heading_rad, state.heading_rad).abs() < MAX_HEADING_DIFFERENCE_RAD);
    let ahead = own.flat_map(|(lane, _)| lanes.ways_ahead(lane.lane, AHEAD_M, N_WAYS));
    let lines = ahead.map(|way| extended(way.iter().flat_map(|lane| &lane.centerline.0)));
    let placed = |line: Polyline| {
        let place = line.project(state.position)?;
        Some(Way { station_m: place.station_m, offset_m: place.offset_m, line })
    };
    let found: Vec<Way> = lines.filter_map(placed).take(N_WAYS).collect();
    if !found.is_empty() {
        return found;
    }
    let straight = [state.position, state.position + Vec2::from_angle(state.heading_rad)];
    placed(extended(straight.iter())).into_iter().collect()
}
