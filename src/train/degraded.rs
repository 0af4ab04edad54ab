//! Scenes as other recordings would have them, so that a network learns to do with less than simulators give.
//!
//! Trackers differ in their errors by orders of magnitude, some datasets have no maps, and some no sizes. A network
//! that has only seen exact pasts, maps and sizes brakes and turns at random where one is missing.

use crate::geometry::{Vec2, wrap_angle};
use crate::scene::{LaneGraph, Scene, State, Track, Trajectory};
use crate::seed::SeededRng;
use std::sync::Arc;

/// Share of scenes seen without their map, …
const WITHOUT_MAP: f64 = 0.1;
/// … without the sizes of agents, …
const WITHOUT_SIZES: f64 = 0.1;
/// … and with errors in the observed states.
const WITH_ERRORS: f64 = 0.25;
/// Logarithms of the least and the largest standard deviation of errors of positions, meters.
const LOG_ERROR_M: [f64; 2] = [-6.0, -1.6];
/// Errors of headings, radians by meter of errors of positions.
const HEADING_ERROR_RAD_PER_M: f64 = 0.15;

/// `scene` as drawn: most stay as they are.
pub(super) fn degraded(mut scene: Scene, rng: &mut SeededRng) -> Scene {
    if rng.uniform() < WITHOUT_MAP {
        scene.lanes = Arc::new(LaneGraph::default());
    }
    if rng.uniform() < WITHOUT_SIZES {
        scene.tracks.iter_mut().for_each(|track| track.extent = None);
    }
    if rng.uniform() < WITH_ERRORS {
        let [least, largest] = LOG_ERROR_M;
        let error_m = (least + rng.uniform() * (largest - least)).exp();
        let (present, dt_s) = (scene.current_timestep(), scene.dt_s);
        for track in &mut scene.tracks {
            track.trajectory = with_errors(track, present, dt_s, error_m, rng);
        }
    }
    scene
}

/// The trajectory with independent errors of its states up to `present`, and with the velocities that follow from them.
fn with_errors(track: &Track, present: usize, dt_s: f64, error_m: f64, rng: &mut SeededRng) -> Trajectory {
    let mut errors: Vec<(usize, Vec2)> = Vec::new();
    let seen = |(timestep, state): (usize, &Option<State>)| {
        let state = (*state)?;
        if timestep > present {
            return Some(state);
        }
        errors.retain(|(of, _)| of + 2 >= timestep);
        errors.push((timestep, Vec2::new(rng.normal(), rng.normal()) * error_m));
        let turn = rng.normal() * error_m * HEADING_ERROR_RAD_PER_M;
        // The slope at the end of the parabola through the last three positions, as ingest has it.
        let slope = match errors[..] {
            [.., (_, a), (_, b), (_, c)] => c * 1.5 - b * 2.0 + a * 0.5,
            [(_, a), (_, b)] => b - a,
            _ => Vec2::ZERO,
        };
        Some(State {
            position: state.position + errors.last().map_or(Vec2::ZERO, |(_, error)| *error),
            heading_rad: wrap_angle(state.heading_rad + turn),
            velocity: state.velocity + slope * dt_s.recip(),
        })
    };
    Trajectory::new(track.trajectory.entries().iter().enumerate().map(seen).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::seed::Seed;

    #[test]
    fn some_scenes_lack_something_and_futures_stay_as_recorded() {
        let recorded = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0, 4.0, 0.0, 8.0)]);
        let present = recorded.current_timestep();
        let mut rng = Seed(1).rng();
        let drawn: Vec<Scene> = (0..400).map(|_| degraded(recorded.clone(), &mut rng)).collect();
        let share = |lacks: &dyn Fn(&Scene) -> bool| drawn.iter().filter(|scene| lacks(scene)).count() as f64 / 400.0;
        let moved =
            |other: &Scene| other.tracks[0].trajectory.get(present) != recorded.tracks[0].trajectory.get(present);
        for (found, expected) in [
            (share(&|scene| !Arc::ptr_eq(&scene.lanes, &recorded.lanes)), WITHOUT_MAP),
            (share(&|scene| scene.tracks[0].extent.is_none()), WITHOUT_SIZES),
            (share(&moved), WITH_ERRORS),
        ] {
            assert!((found - expected).abs() < 0.06, "{found}, expected {expected}");
        }
        for other in &drawn {
            for (a, b) in recorded.tracks.iter().zip(&other.tracks) {
                assert_eq!(a.trajectory.entries()[present + 1..], b.trajectory.entries()[present + 1..]);
            }
        }
    }

    #[test]
    fn velocities_follow_from_the_positions() {
        let recorded = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0, 4.0, 0.0, 8.0)]);
        let (present, dt_s) = (recorded.current_timestep(), recorded.dt_s);
        let mut rng = Seed(2).rng();
        for track in &recorded.tracks {
            let noisy = with_errors(track, present, dt_s, 0.1, &mut rng);
            let error = |timestep: usize| {
                noisy.get(timestep).unwrap().position - track.trajectory.get(timestep).unwrap().position
            };
            let velocity = noisy.get(present).unwrap().velocity - track.trajectory.get(present).unwrap().velocity;
            let slope = error(present) * 1.5 - error(present - 1) * 2.0 + error(present - 2) * 0.5;
            assert!((velocity - slope * dt_s.recip()).norm() < 1e-9);
            let variance = (0..=present).map(|t| error(t).dot(error(t))).sum::<f64>() / (present + 1) as f64;
            assert!(variance.sqrt() > 0.05 && variance.sqrt() < 0.3, "{variance}");
        }
    }
}
