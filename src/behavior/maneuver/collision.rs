//! Driving into each other: two agents continue along their ways, perhaps drifting aside, until they meet, and then
//! brake.

use super::{Driver, Maneuver, Pace};
use crate::behavior::collision::{Collision, core_or_recorded};
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::{InTheWay, quintic};
use crate::geometry::{OrientedBox, Vec2, angle_difference};
use crate::scene::{Extent, Scene};
use std::f64::consts::FRAC_PI_2;

/// Accelerations of the two, m/s², and how far they drift to the left, meters.
const ACCELERATIONS_MPS2: [f64; 4] = [-2.5, -1.0, 0.0, 1.25];
const DRIFTS_M: [f64; 3] = [0.0, 1.2, -1.2];
/// Deceleration after the collision, m/s².
const AFTERWARD_MPS2: f64 = 6.0;
/// Spacing of relative speeds and of angles by which maneuvers are told apart, m/s and radians.
const SPEED_SPACING_MPS: f64 = 2.0;
const ANGLE_SPACING_RAD: f64 = 0.5;

/// A drive along a rail until the end of the scene.
struct RailDrive {
    rail: usize,
    pace: Pace,
    drift_m: f64,
    effort: f64,
    positions: Vec<Vec2>,
    boxes: Vec<Footprint>,
}

impl Collision {
    /// Maneuvers in which two agents collide, each along one of its ways with one acceleration.
    pub(in crate::behavior) fn crashes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        if !agents.iter().all(|idx| self.config().agents.admits(scene.tracks[*idx].class)) {
            return Vec::new();
        }
        let drivers = agents.map(|agent_idx| Driver::new(scene, &lanes, agent_idx));
        let [Some(one), Some(other)] = drivers else { return Vec::new() };
        let extents = agents.map(|agent_idx| core_or_recorded(&scene.tracks[agent_idx]));
        let (ones, others) = (courses(&one, extents[0]), courses(&other, extents[1]));
        let mut maneuvers = Vec::new();
        for (a, b) in ones.iter().flat_map(|a| others.iter().map(move |b| (a, b))) {
            let meets = a.boxes.iter().zip(&b.boxes).position(|(own, theirs)| own.overlaps(theirs));
            let Some(step) = meets else { continue };
            let relative_mps = (a.velocity(step, scene.dt_s) - b.velocity(step, scene.dt_s)).norm();
            let [own_rad, their_rad] = [a, b].map(|course| course.boxes[step].forward.angle());
            let turned_rad = angle_difference(own_rad, their_rad).abs();
            if relative_mps < self.config().min_relative_mps {
                continue;
            }
            let from_s = (step + 1) as f64 * scene.dt_s;
            let stopping = |driver: &Driver, course: &RailDrive| {
                let pace = course.pace.clone().then(from_s, -AFTERWARD_MPS2);
                drifting(driver, (course.rail, &pace, course.drift_m)).0
            };
            maneuvers.push(Maneuver {
                kind: [(relative_mps / SPEED_SPACING_MPS) as usize, (turned_rad / ANGLE_SPACING_RAD) as usize],
                effort: a.effort.max(b.effort),
                parameters: &["relative_speed_mps", "heading_difference_rad", "bearing_rad"],
                in_the_way: Some(InTheWay::Ahead),
                positions: vec![stopping(&one, a), stopping(&other, b)],
            });
        }
        maneuvers
    }
}

impl RailDrive {
    /// Its velocity at a timestep after the present, m/s.
    fn velocity(&self, step: usize, dt_s: f64) -> Vec2 {
        (self.positions[step + 1] - self.positions[step]) * (1.0 / dt_s)
    }
}

/// Courses along each way of an agent, with each acceleration and each drift.
fn courses(driver: &Driver, extent: Extent) -> Vec<RailDrive> {
    let tried = (0..driver.rails.len()).flat_map(|rail| ACCELERATIONS_MPS2.map(|mps2| (rail, mps2)));
    let tried = tried.flat_map(|(rail, mps2)| DRIFTS_M.map(|drift_m| (rail, mps2, drift_m)));
    let course = |(rail, mps2, drift_m): (usize, f64, f64)| {
        let pace = Pace::steady(mps2);
        let (positions, boxes) = drifting(driver, (rail, &pace, drift_m));
        let boxes = boxes.into_iter().map(|(center, heading_rad)| {
            let Extent { length_m, width_m } = extent;
            Footprint::new(&OrientedBox { center, heading_rad, length_m, width_m })
        });
        let effort = pace.effort().max(drift_m.abs() / 2.0);
        RailDrive { rail, drift_m, effort, positions, boxes: boxes.collect(), pace }
    };
    tried.map(course).collect()
}

/// The positions of a drifting agent at present and at each timestep after it, and its poses at the latter. It drifts
/// over the distance that it would drive without braking, so that it does not slide aside while it stops.
fn drifting(driver: &Driver, (rail, pace, drift_m): (usize, &Pace, f64)) -> (Vec<Vec2>, Vec<(Vec2, f64)>) {
    let driven_m = driver.travel(rail, pace).driven_m;
    let way_m = driver.travel(rail, &pace.unchanged()).driven_m.last().copied().unwrap_or_default().max(1.0);
    let aside = |step: usize, (at, along): (Vec2, Vec2)| {
        let share = if step == 0 { 0.0 } else { quintic(driven_m[step - 1] / way_m) };
        at + Vec2::from_angle(along.angle()).rotated(FRAC_PI_2) * (drift_m * share)
    };
    let places = driver.places(rail, &driven_m);
    let positions: Vec<Vec2> = places.iter().enumerate().map(|(step, place)| aside(step, *place)).collect();
    let poses = positions.iter().zip(&places).skip(1).map(|(at, (_, along))| (*at, along.angle())).collect();
    (positions, poses)
}
