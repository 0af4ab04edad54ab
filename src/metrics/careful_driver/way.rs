//! The way of an ego: the path that it drives in a scene and on along its lane, and others as seen from there.

use super::Seen;
use super::bends::BendSpeeds;
use super::watch::IN_LANE_M;
use crate::behavior::driven_path::DrivenPath;
use crate::behavior::footprint::Footprint;
use crate::behavior::may_walk;
use crate::behavior::way_on::{SETTLES_S, aligned_rad, way_on};
use crate::geometry::{OrientedBox, Vec2, angle_difference};
use crate::scene::{Scene, State, Track};
use std::f64::consts::FRAC_PI_2;

/// How far the way goes on after the scene, meters.
const WAY_ON_M: f64 = 300.0;
/// The distance over which an ego beside its way comes over to it, meters.
const COMES_OVER_M: f64 = 7.0;

/// Steps below this have no direction, meters.
const LEAST_STEP_M: f64 = 0.05;
/// The most by which the heading differs from the direction of motion, radians.
const MOST_SLIP_RAD: f64 = 0.1;

/// The way of an ego.
#[derive(Clone)]
pub struct Way {
    /// Its path in the scene from the present on, and on along its lane.
    pub(crate) route: DrivenPath,
    /// How fast it takes the bends after the scene.
    bend_speeds: BendSpeeds,
    /// Its largest speed in the scene, m/s, at which it would like to drive.
    pub(crate) target_speed_mps: f64,
}

/// A road user relative to a way.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    offset_m: f64,
    flank_m: f64,
    /// From the front of an ego at the beginning of the way to the nearest part of it, meters along the way.
    ahead_m: f64,
    along_mps: f64,
    length_m: f64,
    is_on_foot: bool,
}

impl Way {
    /// The way of an agent. `None` if it is absent at present.
    pub(crate) fn of(scene: &Scene, ego_idx: usize) -> Option<Self> {
        let present = scene.current_timestep();
        let now = *scene.state(ego_idx, present).filter(|state| state.is_finite())?;
        let driven: Vec<&State> = (present..scene.n_timesteps).map_while(|t| scene.state(ego_idx, t)).collect();
        let mut points: Vec<Vec2> = driven.iter().map(|state| state.position).collect();
        let ended = Scene { n_timesteps: present + driven.len(), ..scene.clone() };
        let (last, on) = (points[points.len() - 1], way_on(&ended, ego_idx, WAY_ON_M, SETTLES_S));
        points.extend(on);
        if points.iter().all(|point| point.distance(now.position) < 1.0) {
            points = vec![now.position, now.position + Vec2::from_angle(now.heading_rad) * WAY_ON_M];
        }
        let route = DrivenPath::along(&points, scene.tracks[ego_idx].extent_or_nominal().length_m)?;
        let bend_speeds = BendSpeeds::new(&route, route.driven_m(last).unwrap_or_default());
        let target_speed_mps = driven.iter().map(|state| state.speed_mps()).fold(0.0, f64::max);
        Some(Self { route, bend_speeds, target_speed_mps })
    }

    /// The speed at which the ego would like to drive at this place, m/s.
    pub(crate) fn wanted_speed_mps(&self, at: Vec2) -> f64 {
        let in_bend_mps = self.route.driven_m(at).map_or(f64::INFINITY, |driven_m| self.bend_speeds.at(driven_m));
        self.target_speed_mps.min(in_bend_mps)
    }

    /// The ego a timestep later, with this acceleration until then, m/s²; it does not reverse.
    pub(crate) fn advanced(&self, state: &State, acceleration_mps2: f64, dt_s: f64) -> State {
        let speed_mps = state.speed_mps();
        let then_mps = (speed_mps + acceleration_mps2 * dt_s).max(0.0);
        let moved_m = f64::midpoint(speed_mps, then_mps) * dt_s;
        let Some((place, driven_m)) = self.route.project(state.position).zip(self.route.driven_m(state.position))
        else {
            return *state;
        };
        let (center, along_rad) = self.route.pose_at(driven_m + moved_m);
        let aside_m = place.offset_m * (-moved_m / COMES_OVER_M).exp();
        let position = center + Vec2::from_angle(along_rad + FRAC_PI_2) * aside_m;
        // Directions of very short steps are noise.
        if moved_m <= LEAST_STEP_M || speed_mps * dt_s <= LEAST_STEP_M {
            return State { position, velocity: Vec2::from_angle(state.heading_rad) * then_mps, ..*state };
        }
        let course_rad = (position - state.position).angle();
        let slip_rad = angle_difference(state.heading_rad, state.velocity.angle());
        let heading_rad = aligned_rad(course_rad, slip_rad.clamp(-MOST_SLIP_RAD, MOST_SLIP_RAD), dt_s);
        State { position, heading_rad, velocity: Vec2::from_angle(course_rad) * then_mps }
    }

    /// The place of a road user.
    pub(crate) fn place(&self, track: &Track, state: &State) -> Option<Place> {
        let place = self.route.project(state.position)?;
        let body = body(track, state);
        let (footprint, along) = (Footprint::new(&body), Vec2::from_angle(place.heading_rad));
        let offset_m = place.offset_m.abs();
        Some(Place {
            offset_m,
            flank_m: offset_m - footprint.half_extent_m(Vec2::new(-along.y, along.x)),
            ahead_m: self.route.ahead_m(&place, footprint.half_extent_m(along)),
            along_mps: state.velocity.dot(along),
            length_m: body.length_m,
            is_on_foot: may_walk(track.class, state),
        })
    }
}

impl Place {
    /// Whether it is in the lane of the way.
    pub(super) fn is_in_lane(&self) -> bool {
        self.flank_m <= IN_LANE_M
    }

    /// The place as seen from an ego of this length and speed that has driven so far.
    pub(crate) fn seen_from(&self, driven_m: f64, ego_mps: f64, ego_length_m: f64) -> Seen {
        Seen {
            offset_m: self.offset_m,
            flank_m: self.flank_m,
            gap_m: self.ahead_m - driven_m,
            closing_mps: ego_mps - self.along_mps,
            lengths_m: self.length_m + ego_length_m,
            is_on_foot: self.is_on_foot,
        }
    }
}

/// The box of an agent in this state; the least of its class if its size is unknown.
pub(crate) fn body(track: &Track, state: &State) -> OrientedBox {
    let extent = track.extent_or_least();
    OrientedBox {
        center: state.position,
        heading_rad: state.heading_rad,
        length_m: extent.length_m,
        width_m: extent.width_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    #[test]
    fn a_heading_beside_the_motion_aligns_within_a_second() {
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
        let way = Way::of(&scene, 0).unwrap();
        // At most a tenth of a radian is kept.
        for (slip_rad, kept_rad) in [(0.05, 0.05), (-0.05, -0.05), (0.3, 0.1)] {
            let now = *scene.state(0, scene.current_timestep()).unwrap();
            let mut state = State { heading_rad: slip_rad, ..now };
            for _ in 0..10 {
                state = way.advanced(&state, 0.0, 0.1);
            }
            assert!((state.heading_rad - kept_rad * (-1.0_f64).exp()).abs() < 1e-6, "{slip_rad}: {state:?}");
            assert!((state.position.x - now.position.x - 10.0).abs() < 1e-6 && state.velocity.y.abs() < 1e-6);
        }
    }
}
