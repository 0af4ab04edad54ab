//! Scenes with less data, as in other recordings, so that a network learns to do without what simulators provide.
//!
//! Some datasets have no maps, some no sizes, and many have cars that are parked beside the road. A network that has
//! always seen maps and sizes brakes and turns at random when one is missing, and one that has never seen parked cars
//! lets them drive off.
//!
//! Errors of observed states are not included: they are removed before a network sees them.

use crate::geometry::{OrientedBox, Vec2, wrap_angle};
use crate::scene::{Extent, LaneGraph, Scene, State, Track, TrackRole, Trajectory};
use crate::seed::SeededRng;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Share of scenes seen without their map, and without the sizes of agents.
const WITHOUT_MAP: f64 = 0.1;
const WITHOUT_SIZES: f64 = 0.1;

/// Share of scenes in which cars are parked beside the road, and their largest number; simulated traffic has none.
const WITH_PARKED: f64 = 0.25;
const MOST_PARKED: usize = 4;
/// The distance of a parked car beside the way of an agent, meters, and its least distance from the center of any lane
/// and from all bodies.
const BESIDE_M: [f64; 2] = [3.0, 12.0];
const OFF_LANES_M: f64 = 2.6;
const CLEARANCE_M: f64 = 0.5;
/// Standard deviation of their headings about that of the way, radians.
const ASKEW_RAD: f64 = 0.15;

/// `scene` as drawn: most stay as they are.
pub(super) fn degraded(mut scene: Scene, rng: &mut SeededRng) -> Scene {
    if rng.uniform() < WITH_PARKED {
        for i in 0..=rng.below(MOST_PARKED) {
            let parked = parked(&scene, i, rng);
            scene.tracks.extend(parked);
        }
    }
    if rng.uniform() < WITHOUT_MAP {
        scene.lanes = Arc::new(LaneGraph::default());
    }
    if rng.uniform() < WITHOUT_SIZES {
        scene.tracks.iter_mut().for_each(|track| track.extent = None);
    }
    scene
}

/// A car that stands beside the way of an agent throughout, in the scene frame. `None` if the drawn place is not free,
/// or the agent is not motorized.
fn parked(scene: &Scene, number: usize, rng: &mut SeededRng) -> Option<Track> {
    let beside = scene.tracks.get(rng.below(scene.tracks.len()))?;
    let states: Vec<&State> = beside.trajectory.valid().map(|(_, state)| state).collect();
    let at = states.get(rng.below(states.len()))?;
    let side = if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
    let aside_m = side * (BESIDE_M[0] + rng.uniform() * (BESIDE_M[1] - BESIDE_M[0]));
    let position = at.position + Vec2::from_angle(at.heading_rad + FRAC_PI_2) * aside_m;
    let turned_rad = if rng.uniform() < 0.5 { 0.0 } else { PI };
    let heading_rad = wrap_angle(at.heading_rad + turned_rad + rng.normal() * ASKEW_RAD);
    let state = State { position, heading_rad, velocity: Vec2::ZERO };
    let extent = Extent { length_m: 4.0 + rng.uniform(), width_m: 1.7 + 0.3 * rng.uniform() };
    let track = Track {
        id: format!("parked-{number}").as_str().into(),
        class: beside.class.is_motorized().then_some(beside.class)?,
        role: TrackRole::Context,
        extent: Some(extent),
        trajectory: Trajectory::new(vec![Some(state); scene.n_timesteps]),
    };
    let body = OrientedBox {
        center: position,
        heading_rad,
        length_m: extent.length_m + 2.0 * CLEARANCE_M,
        width_m: extent.width_m + 2.0 * CLEARANCE_M,
    };
    let is_off_lanes = scene
        .lanes
        .lanes()
        .iter()
        .all(|lane| lane.centerline.project(position).is_none_or(|place| place.offset_m.abs() > OFF_LANES_M));
    let is_clear = scene.tracks.iter().all(|other| {
        let boxes = (0..scene.n_timesteps).filter_map(|timestep| other.footprint_at(timestep));
        boxes.into_iter().all(|other| !body.overlaps(&other))
    });
    (is_off_lanes && is_clear).then_some(track)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::seed::Seed;

    #[test]
    fn some_scenes_lack_something_and_motion_stays_as_recorded() {
        let recorded = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0, 4.0, 0.0, 8.0)]);
        let mut rng = Seed(1).rng();
        let drawn: Vec<Scene> = (0..400).map(|_| degraded(recorded.clone(), &mut rng)).collect();
        let share = |lacks: &dyn Fn(&Scene) -> bool| drawn.iter().filter(|scene| lacks(scene)).count() as f64 / 400.0;
        for (found, expected) in [
            (share(&|scene| !Arc::ptr_eq(&scene.lanes, &recorded.lanes)), WITHOUT_MAP),
            (share(&|scene| scene.tracks[0].extent.is_none()), WITHOUT_SIZES),
        ] {
            assert!((found - expected).abs() < 0.06, "{found}, expected {expected}");
        }
        let share_parked = share(&|scene| scene.tracks.len() > recorded.tracks.len());
        assert!(share_parked > 0.1 && share_parked <= WITH_PARKED + 0.06, "{share_parked}");
        for other in &drawn {
            for parked in &other.tracks[recorded.tracks.len()..] {
                assert!(parked.trajectory.valid().all(|(_, state)| state.velocity == Vec2::ZERO));
                assert_eq!(parked.trajectory.n_valid(), recorded.n_timesteps);
                for (timestep, track) in
                    (0..recorded.n_timesteps).flat_map(|t| recorded.tracks.iter().map(move |a| (t, a)))
                {
                    let bodies = parked.footprint_at(timestep).zip(track.footprint_at(timestep));
                    assert!(bodies.is_none_or(|(a, b)| !a.overlaps(&b)));
                }
            }
            for (a, b) in recorded.tracks.iter().zip(&other.tracks) {
                assert_eq!(a.trajectory, b.trajectory);
            }
        }
    }
}
