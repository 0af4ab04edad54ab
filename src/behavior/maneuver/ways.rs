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
/// An agent that heads off its lane turns along it within the way that it drives in this time, seconds, and not
/// tighter than over this distance, unless it would drift farther aside than this, meters.
const SETTLES_S: f64 = 1.0;
const LEAST_SETTLING_M: f64 = 4.0;
const MOST_DRIFT_M: f64 = 1.0;

/// A way, and the agent's place on it at present.
pub(super) struct Way {
    line: Polyline,
    station_m: f64,
    offset_m: f64,
    /// How far it drifts aside per meter at present, and the distance over which that falls to a share of 1 / e.
    slope: f64,
    settles_m: f64,
}

impl Way {
    fn new(line: Polyline, state: &State) -> Option<Self> {
        let place = line.project(state.position)?;
        let slope = angle_difference(state.heading_rad, place.heading_rad).tan();
        let settles_m = (state.speed_mps() * SETTLES_S).max(LEAST_SETTLING_M);
        let settles_m = settles_m.min(MOST_DRIFT_M / slope.abs().max(f64::MIN_POSITIVE));
        Some(Self { station_m: place.station_m, offset_m: place.offset_m, line, slope, settles_m })
    }

    /// The agent's position after `driven_m` along the way, at its present offset from the line and what it drifts
    /// aside from there, and its direction.
    pub(super) fn place(&self, driven_m: f64) -> Option<(Vec2, Vec2)> {
        let on_line = self.line.point_at(self.station_m + driven_m)?;
        let along = Vec2::from_angle(self.line.project(on_line)?.heading_rad);
        let left = Vec2::new(-along.y, along.x);
        let remaining = (-driven_m / self.settles_m).exp();
        let drift_m = self.slope * self.settles_m * (1.0 - remaining);
        let ahead = along + left * (self.slope * remaining);
        Some((on_line + left * (self.offset_m + drift_m), ahead * ahead.norm().recip()))
    }
}

/// The ways ahead of an agent: along its lanes, with every choice at a fork; straight on if it is in no lane.
pub(super) fn ways(lanes: &SceneLanes<'_>, state: &State) -> Vec<Way> {
    let own = lanes
        .lanes_at(state.position)
        .filter(|(_, place)| angle_difference(place.heading_rad, state.heading_rad).abs() < MAX_HEADING_DIFFERENCE_RAD);
    let ahead = own.flat_map(|(lane, _)| lanes.ways_ahead(lane.lane, AHEAD_M, N_WAYS));
    let lines = ahead.map(|way| extended(way.iter().flat_map(|lane| &lane.centerline.0)));
    let found: Vec<Way> = lines.filter_map(|line| Way::new(line, state)).take(N_WAYS).collect();
    if !found.is_empty() {
        return found;
    }
    let straight = [state.position, state.position + Vec2::from_angle(state.heading_rad)];
    Way::new(extended(straight.iter()), state).into_iter().collect()
}
