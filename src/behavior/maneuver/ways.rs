//! The ways ahead of an agent in the map, and its possible positions on them.

use crate::behavior::kept_lane::extended;
use crate::behavior::lane_relation::SceneLanes;
use crate::geometry::{Path, Vec2, angle_difference};
use crate::scene::State;
use std::f64::consts::FRAC_PI_4;

/// An agent is only in lanes whose direction differs from its heading by less than this, radians.
const MAX_HEADING_DIFFERENCE_RAD: f64 = FRAC_PI_4;
/// The length of ways, meters: farther than any agent drives in a scene. And the largest number of ways.
const AHEAD_M: f64 = 150.0;
const N_WAYS: usize = 12;
/// An agent that heads off its lane, or is off its middle, comes along it within the distance that it drives in this
/// time, seconds, but over no shorter distance than this, unless it would drift farther aside than this, meters.
const SETTLES_S: f64 = 0.8;
const LEAST_SETTLING_M: f64 = 4.0;
const MOST_DRIFT_M: f64 = 1.0;
/// The largest offset from the middle of its lane that an agent keeps, meters. One that is about to be farther off than
/// [`LEAVES_M`], and than now by [`DRIFTS_M`], moves over to the lane beside, if there is one.
const KEPT_M: f64 = 0.7;
const LEAVES_M: f64 = 1.3;
const DRIFTS_M: f64 = 0.2;
/// The curvature of a line is taken over this distance on either side, meters.
const BEND_M: f64 = 3.0;

/// A way, and the agent's place on it at present.
pub(super) struct Way {
    line: Path,
    station_m: f64,
    /// The offset from the line after d meters is kept + (a + b d + c d²) exp(-d / L): it goes from the present offset,
    /// heading and curvature to the kept offset.
    kept_m: f64,
    fading: [f64; 3],
    settles_m: f64,
}

impl Way {
    fn new(line: Path, state: &State, curvature_1pm: f64) -> Option<Self> {
        let place = line.project(state.position)?;
        let slope = angle_difference(state.heading_rad, place.heading_rad).tan();
        let settles_m = settling_m(state).min(MOST_DRIFT_M / slope.abs().max(f64::MIN_POSITIVE));
        let heading_rad = |at_m: f64| line.pose_at(place.station_m + at_m).map(|(_, heading_rad)| heading_rad);
        let bend_1pm = angle_difference(heading_rad(BEND_M)?, heading_rad(-BEND_M)?) / (2.0 * BEND_M);
        let most_1pm = MOST_DRIFT_M / (settles_m * settles_m);
        let beyond_1pm = (curvature_1pm - bend_1pm).clamp(-most_1pm, most_1pm);
        let kept_m = (place.offset_m + slope * settles_m).clamp(-KEPT_M, KEPT_M);
        let a = place.offset_m - kept_m;
        let b = slope + a / settles_m;
        let c = beyond_1pm / 2.0 + (b - a / (2.0 * settles_m)) / settles_m;
        Some(Self { station_m: place.station_m, line, kept_m, fading: [a, b, c], settles_m })
    }

    /// The agent's position after `driven_m` along the way, and its direction.
    pub(super) fn place(&self, driven_m: f64) -> Option<(Vec2, Vec2)> {
        let (on_line, heading_rad) = self.line.pose_at(self.station_m + driven_m)?;
        let along = Vec2::from_angle(heading_rad);
        let left = along.left();
        let [a, b, c] = self.fading;
        let remaining = (-driven_m / self.settles_m).exp();
        let fading_m = a + (b + c * driven_m) * driven_m;
        let slope = (b + 2.0 * c * driven_m - fading_m / self.settles_m) * remaining;
        let ahead = along + left * slope;
        Some((on_line + left * (self.kept_m + fading_m * remaining), ahead.unit()))
    }
}

fn settling_m(state: &State) -> f64 {
    (state.speed_mps() * SETTLES_S).max(LEAST_SETTLING_M)
}

/// The ways ahead of an agent that drives this curvature, 1/m: along its lanes, or those beside to which it moves over,
/// with every choice at a fork; straight on if it is in no lane.
pub(super) fn ways(lanes: &SceneLanes<'_>, state: &State, curvature_1pm: f64) -> Vec<Way> {
    let own = lanes
        .lanes_at(state.position)
        .filter(|(_, place)| angle_difference(place.heading_rad, state.heading_rad).abs() < MAX_HEADING_DIFFERENCE_RAD);
    let kept = own.flat_map(|(lane, place)| {
        let slope = angle_difference(state.heading_rad, place.heading_rad).tan();
        let soon_m = place.offset_m + slope * settling_m(state);
        let leaves = soon_m.abs() > LEAVES_M && soon_m.abs() > place.offset_m.abs() + DRIFTS_M;
        let mut beside = if leaves { lanes.beside(lane, state.position) } else { Vec::new() };
        beside.retain(|(_, side)| *side == soon_m.signum());
        let over: Vec<_> = beside.into_iter().map(|(lane, _)| lane.lane).collect();
        if over.is_empty() { vec![lane.lane] } else { over }
    });
    let ahead = kept.flat_map(|lane| lanes.ways_ahead(lane, AHEAD_M, N_WAYS));
    let lines = ahead.map(|way| extended(way.iter().flat_map(|lane| &lane.centerline.0)));
    let found: Vec<Way> = lines.filter_map(|line| Way::new(line, state, curvature_1pm)).take(N_WAYS).collect();
    if !found.is_empty() {
        return found;
    }
    let straight = [state.position, state.position + Vec2::from_angle(state.heading_rad)];
    Way::new(extended(straight.iter()), state, 0.0).into_iter().collect()
}
