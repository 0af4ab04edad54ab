//! Where can two road users go, and where would they meet?

use super::ways::ways;
use super::{ACCELERATIONS_MPS2, LATERAL_ACCELERATION_MPS2, effort, horizon_s};
use crate::behavior::AgentFilter;
use crate::behavior::lane_relation::SceneLanes;
use crate::geometry::Vec2;
use crate::scene::{Extent, Scene};

/// The accelerations that are tried, m/s²: the limits, half of them, and coasting.
const TRIED_MPS2: [f64; 5] = [*ACCELERATIONS_MPS2.start(), -2.0, 0.0, 1.25, *ACCELERATIONS_MPS2.end()];
/// Spacing of the times that are tried, seconds.
const SPACING_S: f64 = 0.25;
/// Nobody evades farther than this, meters.
const MOST_ASIDE_M: f64 = 1.75;
/// The positions of an agent that continues along one of its ways with one acceleration.
pub(super) struct Course {
    pub(super) effort: f64,
    /// Its positions at the tried times.
    pub(super) places: Vec<Place>,
}

/// A position, with the direction of motion and its speed.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) at: Vec2,
    pub(super) along: Vec2,
    pub(super) speed_mps: f64,
}

/// Two agents at one place at one time.
pub(super) struct Meeting {
    /// Their relative speed, m/s.
    pub(super) relative_mps: f64,
    /// By how much their courses differ, radians.
    pub(super) heading_difference_rad: f64,
    /// The effort of meeting, from 0 to 1.
    pub(super) effort: f64,
}

/// The courses of two agents that `filter` admits, one of which moves at `least_mps` or faster at present; `None` if
/// one of them is not tracked then.
pub(super) fn both_courses(
    scene: &Scene,
    agents: [usize; 2],
    filter: AgentFilter,
    least_mps: f64,
) -> Option<[Vec<Course>; 2]> {
    let lanes = SceneLanes::new(&scene.lanes);
    let n_times = (horizon_s(scene) / SPACING_S).floor() as usize;
    let speed_mps = |agent_idx: &usize| Some(scene.state(*agent_idx, scene.current_timestep())?.speed_mps());
    let is_admitted = |agent_idx: &usize| filter.admits(scene.tracks[*agent_idx].class);
    if !agents.iter().all(is_admitted) || agents.iter().filter_map(speed_mps).all(|speed_mps| speed_mps < least_mps) {
        return None;
    }
    let [first, second] = agents.map(|agent_idx| courses(scene, &lanes, agent_idx, n_times));
    Some([first?, second?])
}

/// All encounters in which boxes of these sizes come within `near_m` of each other on any two courses.
pub(super) fn meetings([own, others]: &[Vec<Course>; 2], extents: [Extent; 2], near_m: f64) -> Vec<Meeting> {
    let mut found = Vec::new();
    for (one, other) in own.iter().flat_map(|one| others.iter().map(move |other| (one, other))) {
        for (i, (a, b)) in one.places.iter().zip(&other.places).enumerate() {
            let evaded = evasion_effort([*a, *b], extents, near_m, (i + 1) as f64 * SPACING_S);
            found.extend(evaded.map(|evaded| Meeting {
                relative_mps: (a.along * a.speed_mps - b.along * b.speed_mps).norm(),
                heading_difference_rad: a.along.dot(b.along).clamp(-1.0, 1.0).acos(),
                effort: evaded.max(one.effort).max(other.effort),
            }));
        }
    }
    found
}

/// The effort for two agents to touch at these places, `elapsed_s` from now, if one of them moves across to the other:
/// the share of its largest lateral motion. `None` if they cannot.
fn evasion_effort(
    [one, other]: [Place; 2],
    [extent, other_extent]: [Extent; 2],
    near_m: f64,
    elapsed_s: f64,
) -> Option<f64> {
    // Half the extent of the other's box along and across the first one's direction.
    let along = one.along;
    let (cos, sin) = (along.dot(other.along).abs(), along.cross(other.along).abs());
    let (length_m, width_m) = (other_extent.length_m / 2.0, other_extent.width_m / 2.0);
    let ahead_m =
        along.dot(other.at - one.at).abs() - extent.length_m / 2.0 - (length_m * cos + width_m * sin) - near_m;
    let aside_m =
        along.cross(other.at - one.at).abs() - extent.width_m / 2.0 - (length_m * sin + width_m * cos) - near_m;
    let most_m = (LATERAL_ACCELERATION_MPS2 * elapsed_s.powi(2) / 4.0).min(MOST_ASIDE_M);
    (ahead_m <= 0.0 && aside_m <= most_m).then(|| if aside_m > 0.0 { aside_m / most_m } else { 0.0 })
}

/// The courses of an agent; `None` if it is not tracked at present.
fn courses(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize, n_times: usize) -> Option<Vec<Course>> {
    let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
    let speed_mps = state.speed_mps();
    let ways = ways(lanes, state);
    let tried = ways.iter().flat_map(|way| TRIED_MPS2.map(|acceleration_mps2| (way, acceleration_mps2)));
    let courses = tried.map(|(way, acceleration_mps2)| {
        // Who brakes to a halt stands.
        let moving_s = |elapsed_s: f64| match acceleration_mps2 {
            braking if braking < 0.0 => elapsed_s.min(-speed_mps / braking),
            _ => elapsed_s,
        };
        let place = |elapsed_s: f64| {
            let moving_s = moving_s(elapsed_s);
            let (at, along) = way.place(speed_mps * moving_s + acceleration_mps2 * moving_s.powi(2) / 2.0)?;
            Some(Place { at, along, speed_mps: speed_mps + acceleration_mps2 * moving_s })
        };
        let places = (1..=n_times).map_while(|i| place(i as f64 * SPACING_S)).collect();
        Course { effort: effort(acceleration_mps2), places }
    });
    Some(courses.collect())
}
