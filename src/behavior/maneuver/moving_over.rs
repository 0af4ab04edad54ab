//! Moving over to the lane beside, as lane changes and cut-outs do, or to the oncoming one.

use super::{Driver, Pace};
use crate::behavior::kept_lane::KeptLane;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::effort;
use crate::behavior::template::{QUINTIC_PEAK, quintic};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;
use std::f64::consts::FRAC_PI_4;

/// A vehicle is in a lane only if it heads along it within this angle, radians.
const ALONG_RAD: f64 = FRAC_PI_4;
/// The least speed at which vehicles move over, m/s.
const LEAST_SPEED_MPS: f64 = 2.0;
/// When moving over begins and how long it takes, seconds.
const BEGINS_S: [f64; 3] = [0.0, 0.5, 1.0];
const TAKES_S: [f64; 4] = [2.4, 3.0, 3.8, 4.6];
/// The largest lateral acceleration, m/s²: of a car, and of a vehicle that is longer than cars are, meters.
const MOST_ACROSS_MPS2: f64 = 3.0;
const LONG_ACROSS_MPS2: f64 = 1.5;
const LONG_M: f64 = 6.5;
/// The largest angle to the lane while moving over, radians.
const MOST_ANGLE_RAD: f64 = 0.35;
/// The largest slope of the way over from 0 to 1.
const SLOPE_PEAK: f64 = 1.875;
/// Accelerations along the lane, m/s².
const ALONG_MPS2: [f64; 3] = [0.0, 0.8, -1.0];

/// One way to move over.
pub(super) struct MovingOver {
    /// The side: 1 for the left, -1 for the right.
    pub(super) side: f64,
    /// When the center is midway between the lanes, seconds after the present.
    pub(super) midway_s: f64,
    /// The share of the limits of driving that it takes.
    pub(super) effort: f64,
    /// The positions at present and at each timestep after it.
    pub(super) positions: Vec<Vec2>,
}

/// The ways in which an agent can move over to a lane beside its own. Empty if it is in no lane, or too slow.
pub(super) fn ways_over(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Vec<MovingOver> {
    let Some(driver) = Driver::new(scene, lanes, agent_idx) else { return Vec::new() };
    let now = driver.state;
    let is_along = |heading_rad: f64| angle_difference(heading_rad, now.heading_rad).abs() < ALONG_RAD;
    let own = lanes.lanes_at(now.position).filter(|(_, place)| is_along(place.heading_rad));
    let mut beside: Vec<_> = own.flat_map(|(own, _)| lanes.beside(own, now.position)).collect();
    beside.sort_by_key(|(lane, side)| (lane.lane.id, *side > 0.0));
    beside.dedup_by_key(|(lane, side)| (lane.lane.id, *side > 0.0));
    let targets = beside.into_iter().map(|(lane, side)| (KeptLane::from_lane(lanes, lane), side));
    let most_mps2 = most_across_mps2(scene, agent_idx);
    targets.flat_map(|(target, side)| over_to(scene, &driver, &target, side, most_mps2)).collect()
}

/// The ways in which an agent can move over to an oncoming lane beside its own, to drive against it.
pub(super) fn ways_over_to_oncoming(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Vec<MovingOver> {
    let Some(driver) = Driver::new(scene, lanes, agent_idx) else { return Vec::new() };
    let oncoming = lanes.oncoming(driver.state.position, driver.state.heading_rad).into_iter();
    let targets = oncoming.map(|(lane, side)| (KeptLane::from_lane(lanes, lane).reversed(), side));
    let most_mps2 = most_across_mps2(scene, agent_idx);
    targets.flat_map(|(target, side)| over_to(scene, &driver, &target, side, most_mps2)).collect()
}

fn most_across_mps2(scene: &Scene, agent_idx: usize) -> f64 {
    let is_long = scene.tracks[agent_idx].extent_or_nominal().length_m > LONG_M;
    if is_long { LONG_ACROSS_MPS2 } else { MOST_ACROSS_MPS2 }
}

/// The ways in which a driver can move over to a lane that lies to this side. Empty if it is too slow.
fn over_to(scene: &Scene, driver: &Driver, target: &KeptLane, side: f64, most_mps2: f64) -> Vec<MovingOver> {
    let now = driver.state;
    let Some(aside_m) = target.project(now.position).map(|place| place.offset_m.abs()) else { return Vec::new() };
    let mut found = Vec::new();
    if now.speed_mps() < LEAST_SPEED_MPS {
        return found;
    }
    for (along_mps2, rail) in ALONG_MPS2.iter().flat_map(|mps2| (0..driver.rails.len()).map(move |rail| (*mps2, rail)))
    {
        let driven_m = driver.travel(rail, &Pace::steady(along_mps2)).driven_m;
        let on_own = driver.positions(rail, &driven_m);
        let on_target: Option<Vec<Vec2>> =
            on_own.iter().map(|at| target.point_at(target.project(*at)?.station_m)).collect();
        let Some(on_target) = on_target else { continue };
        for (begins_s, takes_s) in BEGINS_S.iter().flat_map(|b| TAKES_S.map(|t| (*b, t))) {
            let across_mps2 = QUINTIC_PEAK * aside_m / (takes_s * takes_s);
            let driven_m = |until_s: f64| driven_m[((until_s / scene.dt_s) as usize).clamp(1, driven_m.len()) - 1];
            let along_m = driven_m(begins_s + takes_s) - if begins_s > 0.0 { driven_m(begins_s) } else { 0.0 };
            if across_mps2 > most_mps2 || SLOPE_PEAK * aside_m > MOST_ANGLE_RAD.tan() * along_m {
                continue;
            }
            let share = |step: usize| quintic((step as f64 * scene.dt_s - begins_s) / takes_s);
            let both = on_own.iter().zip(&on_target).enumerate();
            let positions = both.map(|(step, (own, there))| own.lerp(*there, share(step))).collect();
            let effort = effort(along_mps2).max(across_mps2 / MOST_ACROSS_MPS2);
            found.push(MovingOver { side, midway_s: begins_s + takes_s / 2.0, effort, positions });
        }
    }
    found
}
