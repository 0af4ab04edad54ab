//! Driving into each other: two who go on as drivers do until they meet, and brake then.

use super::{Driver, Maneuver, ORDINARY_MPS2, Pace};
use crate::behavior::collision::{Collision, core_or_recorded};
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;

/// How hard vehicles that have met come to a halt, m/s².
const AFTERWARD_MPS2: f64 = 6.0;
/// Maneuvers are alike whose relative speeds and angles differ by less than this, m/s and radians.
const SPEED_SPACING_MPS: f64 = 2.0;
const ANGLE_SPACING_RAD: f64 = 0.5;

/// A drive along a rail until the end of the scene.
struct Course {
    rail: usize,
    mps2: f64,
    effort: f64,
    boxes: Vec<Footprint>,
    speeds_mps: Vec<f64>,
}

impl Collision {
    /// How two drive into each other, each along one of its ways with one acceleration.
    pub(in crate::behavior) fn crashes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        if !agents.iter().all(|idx| self.config().agents.admits(scene.tracks[*idx].class)) {
            return Vec::new();
        }
        let [Some(one), Some(other)] = agents.map(|agent_idx| Driver::new(scene, &lanes, agent_idx)) else {
            return Vec::new();
        };
        let extents = agents.map(|agent_idx| core_or_recorded(&scene.tracks[agent_idx]));
        let (ones, others) = (courses(&one, extents[0]), courses(&other, extents[1]));
        let mut maneuvers = Vec::new();
        for (a, b) in ones.iter().flat_map(|a| others.iter().map(move |b| (a, b))) {
            let meets = a.boxes.iter().zip(&b.boxes).position(|(own, theirs)| own.overlaps(theirs));
            let Some(step) = meets else { continue };
            let velocity = |course: &Course| course.boxes[step].forward * course.speeds_mps[step];
            let relative_mps = (velocity(a) - velocity(b)).norm();
            let angle = |forward: Vec2| forward.angle();
            let turned_rad = angle_difference(angle(a.boxes[step].forward), angle(b.boxes[step].forward)).abs();
            if relative_mps < self.config().min_relative_mps {
                continue;
            }
            let from_s = (step + 1) as f64 * scene.dt_s;
            let driven_m = |driver: &Driver, course: &Course| {
                let pace = Pace::steady(course.mps2).then(from_s, -AFTERWARD_MPS2);
                driver.positions(course.rail, &driver.progress(&pace).driven_m)
            };
            maneuvers.push(Maneuver {
                kind: [(relative_mps / SPEED_SPACING_MPS) as usize, (turned_rad / ANGLE_SPACING_RAD) as usize],
                effort: a.effort.max(b.effort),
                parameters: &["relative_speed_mps", "heading_difference_rad", "bearing_rad"],
                in_the_way: Some(InTheWay::Ahead),
                positions: vec![driven_m(&one, a), driven_m(&other, b)],
            });
        }
        maneuvers
    }
}

/// Along each of its ways with each ordinary acceleration.
fn courses(driver: &Driver, extent: crate::scene::Extent) -> Vec<Course> {
    let tried = (0..driver.rails.len()).flat_map(|rail| ORDINARY_MPS2.map(|mps2| (rail, mps2)));
    let course = |(rail, mps2): (usize, f64)| {
        let pace = Pace::steady(mps2);
        let progress = driver.progress(&pace);
        let boxes = driver.boxes(rail, &progress.driven_m, extent);
        Course { rail, mps2, effort: pace.effort(), boxes, speeds_mps: progress.speeds_mps }
    };
    tried.map(course).collect()
}
