//! Driving into each other: two agents continue along their ways, perhaps drifting aside, and brake too late.

use super::{Driver, Maneuver, Pace};
use crate::behavior::collision::{Collision, core_or_recorded};
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::{InTheWay, QUINTIC_SLOPE, quintic};
use crate::geometry::Vec2;
use crate::scene::{Extent, Scene};

/// Accelerations of the two agents, m/s², and how far they drift to the left, meters.
const ACCELERATIONS_MPS2: [f64; 3] = [-2.5, -1.0, 0.0];
const DRIFTS_M: [f64; 3] = [0.0, 1.2, -1.2];
/// An agent drifts aside at an angle below this, radians: at walking pace, more would be steering into the other.
const MOST_DRIFT_RAD: f64 = 0.15;
/// Deceleration of an agent that sees the other, m/s², and how long before they would meet it begins, seconds.
const BRAKES_MPS2: f64 = 7.0;
const BRAKES_BEFORE_S: [f64; 3] = [0.8, 0.5, 0.2];
/// An agent that is hit from behind, within this angle, does not brake, radians.
const FROM_BEHIND_RAD: f64 = 0.5;
/// The least relative speed, m/s: at walking pace boxes touch and nothing happens.
const LEAST_RELATIVE_MPS: f64 = 2.0;
/// Bodies overlap by this at most, meters: there is no model of what a collision does to them.
const MOST_CRUSH_M: f64 = 0.5;
/// Spacing of relative speeds and of angles by which maneuvers are distinguished, m/s and radians.
const SPEED_SPACING_MPS: f64 = 2.0;
const ANGLE_SPACING_RAD: f64 = 0.5;

/// A drive along a rail until the end of the scene.
struct RailDrive {
    rail: usize,
    pace: Pace,
    drift_m: f64,
    /// How far it would drive without braking, meters.
    way_m: f64,
    effort: f64,
    positions: Vec<Vec2>,
    boxes: Vec<Footprint>,
}

impl Collision {
    /// Maneuvers in which two agents collide, each along one of its ways with one acceleration.
    pub(in crate::behavior) fn crashes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        if !agents.iter().all(|idx| scene.tracks[*idx].class.is_road_user()) {
            return Vec::new();
        }
        let drivers = agents.map(|agent_idx| Driver::new(scene, &lanes, agent_idx));
        let [Some(one), Some(other)] = drivers else { return Vec::new() };
        let extents = agents.map(|agent_idx| core_or_recorded(&scene.tracks[agent_idx]));
        let mut drivers = [one, other];
        Driver::keep_rails_that_meet(&mut drivers, extents);
        let [one, other] = drivers;
        let (ones, others) = (courses(&one, extents[0]), courses(&other, extents[1]));
        let mut maneuvers = Vec::new();
        for (a, b) in ones.iter().flat_map(|a| others.iter().map(move |b| (a, b))) {
            // An agent that drifts into another is inattentive; two that drift would aim at each other.
            if a.drift_m != 0.0 && b.drift_m != 0.0 {
                continue;
            }
            let Some(step) = meet(a, b) else { continue };
            let [own, theirs] = [a, b].map(|course| &course.boxes[step]);
            let turned_rad = own.forward.angle_to(theirs.forward).abs();
            let is_ahead = |own: &Footprint, other: &Footprint| (own.center - other.center).dot(own.forward) > 0.0;
            let brakes = |own: &Footprint, other: &Footprint| turned_rad > FROM_BEHIND_RAD || !is_ahead(own, other);
            // An agent that moves aside from behind has seen the one ahead.
            let drifts = [a, b].map(|course| course.drift_m != 0.0);
            if turned_rad <= FROM_BEHIND_RAD && drifts.contains(&true) && !are_beside(scene, agents, extents) {
                continue;
            }
            for before_s in BRAKES_BEFORE_S {
                let from_s = ((step + 1) as f64 * scene.dt_s - before_s).max(0.0);
                let braking = |driver: &Driver, course: &RailDrive, extent: Extent, brakes: bool| {
                    brakes.then(|| {
                        let pace = course.pace.clone().then(from_s, -BRAKES_MPS2);
                        let driven_m = driver.travel(course.rail, &pace).driven_m;
                        RailDrive::new(driver, extent, &driven_m, (course.rail, pace, course.drift_m, course.way_m))
                    })
                };
                let braked_a = braking(&one, a, extents[0], brakes(own, theirs));
                let braked_b = braking(&other, b, extents[1], brakes(theirs, own));
                let (a, b) = (braked_a.as_ref().unwrap_or(a), braked_b.as_ref().unwrap_or(b));
                let Some(step) = meet(a, b) else { continue };
                let relative_mps = (a.velocity(step, scene.dt_s) - b.velocity(step, scene.dt_s)).norm();
                let apart = |step: usize| a.positions[step + 1] - b.positions[step + 1];
                let crush_m = (step..a.boxes.len()).map(|then| apart(then).distance(apart(step))).fold(0.0, f64::max);
                if relative_mps < LEAST_RELATIVE_MPS || crush_m > MOST_CRUSH_M {
                    continue;
                }
                maneuvers.push(Maneuver {
                    kind: [(relative_mps / SPEED_SPACING_MPS) as usize, (turned_rad / ANGLE_SPACING_RAD) as usize],
                    effort: a.effort.max(b.effort),
                    parameters: &["relative_speed_mps", "heading_difference_rad", "bearing_rad"],
                    in_the_way: Some(InTheWay::Ahead),
                    others: Vec::new(),
                    positions: vec![a.positions.clone(), b.positions.clone()],
                });
            }
        }
        maneuvers
    }
}

/// Whether the two are side by side at present.
fn are_beside(scene: &Scene, agents: [usize; 2], extents: [Extent; 2]) -> bool {
    let [Some(one), Some(other)] = agents.map(|idx| scene.state(idx, scene.current_timestep())) else { return false };
    let along_m = (other.position - one.position).dot(Vec2::from_angle(one.heading_rad));
    along_m.abs() < (extents[0].length_m + extents[1].length_m) / 2.0
}

/// The first step at which the boxes of the two touch.
fn meet(one: &RailDrive, other: &RailDrive) -> Option<usize> {
    one.boxes.iter().zip(&other.boxes).position(|(own, theirs)| own.overlaps(theirs))
}

impl RailDrive {
    /// The drive of these distances along a rail. It drifts aside over the way that it would drive without braking, so
    /// that it does not slide aside while it stops.
    fn new(
        driver: &Driver,
        extent: Extent,
        driven_m: &[f64],
        (rail, pace, drift_m, way_m): (usize, Pace, f64, f64),
    ) -> Self {
        let places = driver.places(rail, driven_m);
        let forwards = places.iter().map(|(_, along)| along.unit());
        let shares = std::iter::once(0.0).chain(driven_m.iter().map(|driven_m| quintic(driven_m / way_m.max(1.0))));
        let asides = forwards.zip(shares).map(|(forward, share)| (forward, forward.left() * (drift_m * share)));
        let sides_m = [extent.length_m, extent.width_m];
        let (positions, boxes): (Vec<Vec2>, Vec<Footprint>) = places
            .iter()
            .zip(asides)
            .map(|((at, _), (forward, aside))| (*at + aside, Footprint::along(*at + aside, forward, sides_m)))
            .unzip();
        let effort = pace.effort().max(drift_m.abs() / 2.0);
        Self { rail, drift_m, way_m, effort, positions, boxes: boxes[1..].to_vec(), pace }
    }

    /// Its velocity at a timestep after the present, m/s.
    fn velocity(&self, step: usize, dt_s: f64) -> Vec2 {
        (self.positions[step + 1] - self.positions[step]) * (1.0 / dt_s)
    }
}

/// Courses along each way of an agent, with each acceleration and each drift. An agent that brakes does not let go of
/// the brake.
fn courses(driver: &Driver, extent: Extent) -> Vec<RailDrive> {
    let mut courses = Vec::new();
    for (rail, mps2) in (0..driver.rails.len()).flat_map(|rail| ACCELERATIONS_MPS2.map(|mps2| (rail, mps2))) {
        let pace = Pace::steady(mps2.min(driver.braking_mps2()));
        let driven_m = driver.travel(rail, &pace).driven_m;
        let way_m = driven_m.last().copied().unwrap_or_default();
        let drifts = DRIFTS_M.into_iter().filter(|m| QUINTIC_SLOPE * m.abs() <= MOST_DRIFT_RAD.tan() * way_m);
        courses.extend(
            drifts.map(|drift_m| RailDrive::new(driver, extent, &driven_m, (rail, pace.clone(), drift_m, way_m))),
        );
    }
    courses
}
