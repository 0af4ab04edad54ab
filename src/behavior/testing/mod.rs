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
    lane_graph(&format!("lanes = [{FORK} {}] }}]", bend()))
}

/// [`fork`] with an oncoming lane 3.5 m to the left of the straight one, and with a lane that leads on from the bend.
pub(crate) fn fork_with_oncoming() -> LaneGraph {
    let bend = bend();
    lane_graph(&format!(
        "lanes = [{FORK} {bend}], successors = [4] }},
            {{ id = 4, centerline = [[30.0, 10.0], [30.0, 60.0]] }},
            {{ id = 5, centerline = [[160.0, 3.5], [-100.0, 3.5]] }}]"
    ))
}

/// The lanes of the fork, up to the points of the bend.
const FORK: &str = "
    { id = 1, centerline = [[-50.0, 0.0], [20.0, 0.0]], successors = [2, 3] },
    { id = 2, centerline = [[20.0, 0.0], [100.0, 0.0]] },
    { id = 3, centerline = [";

/// A main road along x that has the right of way, and a side road along y that crosses it and has this role in the
/// rule.
pub(crate) fn side_road(role: &str) -> LaneGraph {
    side_road_onto(role, "[0, -6], [0, 100]")
}

/// [`side_road`] that turns right into the main road and has to yield.
pub(crate) fn merging_side_road() -> LaneGraph {
    let arc = (0..=9).map(|i| (f64::from(i) * 10.0).to_radians());
    let point = |turned: f64| format!("[{}, {}], ", 6.0 - 6.0 * turned.cos(), 6.0 * turned.sin() - 6.0);
    side_road_onto("yield", &format!("{}[100, 0]", arc.map(point).collect::<String>()))
}

fn side_road_onto(role: &str, onto: &str) -> LaneGraph {
    let rule = |role: &str| format!(r#"tags = {{ "regulatory:1" = "role={role};subtype=right_of_way" }}"#);
    lane_graph(&format!(
        "lanes = [
            {{ id = 1, centerline = [[-100, 0], [-6, 0]], successors = [2], {} }},
            {{ id = 2, centerline = [[-6, 0], [100, 0]] }},
            {{ id = 3, centerline = [[0, -100], [0, -6]], successors = [4], {} }},
            {{ id = 4, centerline = [{onto}] }}]",
        rule("right_of_way"),
        rule(role)
    ))
}

/// A lane along x with an all-way stop at x = -6 m.
pub(crate) fn stop_line() -> LaneGraph {
    lane_graph(
        "lanes = [
            { id = 1, centerline = [[-100, 0], [-6, 0]], successors = [2], tags = { 'regulatory:1' = \
         'role=yield;subtype=all_way_stop' } },
            { id = 2, centerline = [[-6, 0], [100, 0]] }]",
    )
}

/// A quarter of a circle of 10 m from (20, 0) to (30, 10).
fn bend() -> String {
    let points = (0..=9).map(|i| (f64::from(i) * 10.0).to_radians());
    let point = |angle: f64| format!("[{}, {}]", 20.0 + 10.0 * angle.sin(), 10.0 - 10.0 * angle.cos());
    points.map(point).collect::<Vec<_>>().join(", ")
}
