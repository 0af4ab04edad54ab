//! The constant-velocity baseline, which every forecast must beat.

use super::sample_group::future;
use crate::scene::{Scene, State, Track, Trajectory};

/// The scene with its future replaced: every agent keeps its velocity and heading at present, t_obs - 1. Agents not
/// tracked at present have no future states. The history does not change.
pub fn constant_velocity(scene: &Scene) -> Scene {
    let tracks = scene.tracks.iter().map(|track| Track { trajectory: extrapolated(scene, track), ..track.clone() });
    Scene { tracks: tracks.collect(), ..scene.clone() }
}

fn extrapolated(scene: &Scene, track: &Track) -> Trajectory {
    let present = scene.current_timestep();
    let last = track.trajectory.get(present).copied();
    let later = |timestep: usize| {
        last.map(|state| {
            let elapsed_s = (timestep - present) as f64 * scene.dt_s;
            State { position: state.position + state.velocity * elapsed_s, ..state }
        })
    };
    let history = (0..scene.n_history).map(|timestep| track.trajectory.get(timestep).copied());
    Trajectory::new(history.chain(future(scene).map(later)).collect())
}
