//! Scenes for tests: small traffic written down in TOML, and scenes drawn at random.

mod case;
mod cases_test;
mod motion;
mod random;

use crate::scene::testing::{Drive, scene};
use crate::scene::{LaneGraph, Scene, State, Trajectory};

pub(crate) use case::{Case, LaneSpec, SceneSpec, cases_in, lane_graph};
pub(crate) use random::{random_scene, transformed};

/// Vehicles that go straight on among these lanes, with 4 s of future at ten states a second.
pub(crate) fn going_on(drives: &[Drive], lanes: LaneGraph) -> Scene {
    let mut scene = scene(drives);
    scene.lanes = lanes.into();
    scene.n_timesteps = scene.n_history + 40;
    for track in &mut scene.tracks {
        let now = *track.trajectory.get(scene.n_history - 1).unwrap();
        let at = |timestep: usize| {
            let elapsed_s = (timestep as f64 - (scene.n_history - 1) as f64) * scene.dt_s;
            Some(State { position: now.position + now.velocity * elapsed_s, ..now })
        };
        track.trajectory = Trajectory::new((0..scene.n_timesteps).map(at).collect());
    }
    scene
}

/// Two lanes along x, 3.5 m apart: the first along y = 0, the second to its left.
pub(crate) fn two_lanes() -> LaneGraph {
    lane_graph(
        "lanes = [
            { id = 1, centerline = [[-100, 0], [200, 0]], width_m = 3.5 },
            { id = 2, centerline = [[-100, 3.5], [200, 3.5]], width_m = 3.5 },
        ]",
    )
}

/// A lane along x that forks at x = 20 m: straight on, and to the left on a quarter of a circle of 10 m.
pub(crate) fn fork() -> LaneGraph {
    let bend: Vec<String> = (0..=9)
        .map(|i| (f64::from(i) * 10.0).to_radians())
        .map(|angle| format!("[{}, {}]", 20.0 + 10.0 * angle.sin(), 10.0 - 10.0 * angle.cos()))
        .collect();
    lane_graph(&format!(
        "lanes = [
            {{ id = 1, centerline = [[-50.0, 0.0], [20.0, 0.0]], successors = [2, 3] }},
            {{ id = 2, centerline = [[20.0, 0.0], [100.0, 0.0]] }},
            {{ id = 3, centerline = [{}] }},
        ]",
        bend.join(", ")
    ))
}
