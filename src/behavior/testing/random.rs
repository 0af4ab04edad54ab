//! Random traffic: agents on smooth paths close enough together that they meet.

use crate::behavior::testing::SceneSpec;
use crate::geometry::{Transform2, Vec2, wrap_angle};
use crate::scene::{AgentClass, Extent, Scene, State, Track, TrackId, TrackRole, Trajectory};
use crate::seed::{Seed, SeededRng};
use std::sync::Arc;

/// A scene of `n_agents` agents within `size_m` of the origin, with 10 + 30 timesteps, some of them not tracked.
pub(crate) fn random_scene(seed: u64, n_agents: usize, size_m: f64) -> Scene {
    let mut rng = Seed(seed).derive("random_scene", &[]).rng();
    let empty: SceneSpec = toml::from_str("agents = []").expect("valid");
    let tracks = (0..n_agents).map(|agent_idx| random_track(&mut rng, agent_idx, size_m, 40, 0.1)).collect();
    Scene { tracks, ..empty.build(&format!("random-{seed}")) }
}

fn random_track(rng: &mut SeededRng, agent_idx: usize, size_m: f64, n_timesteps: usize, dt_s: f64) -> Track {
    let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
    let extent = Extent { length_m: between(2.0, 12.0), width_m: between(0.8, 2.6) };
    let mut position = Vec2::new(between(-size_m, size_m), between(-size_m, size_m));
    // Half of the agents follow the x axis, so that there is lane following and passing too.
    let mut heading_rad = if between(0.0, 1.0) < 0.5 { between(-0.1, 0.1) } else { between(-3.0, 3.0) };
    let (mut speed_mps, yaw_rate_radps) = (between(0.0, 15.0), between(-0.3, 0.3));
    let acceleration_mps2 = between(-3.0, 3.0);
    let gap = (between(0.0, 80.0) as usize, between(0.0, 10.0) as usize);
    let states = (0..n_timesteps).map(|timestep| {
        let velocity = Vec2::from_angle(heading_rad) * speed_mps;
        let state = State { position, heading_rad: wrap_angle(heading_rad), velocity };
        position = position + velocity * dt_s;
        heading_rad += yaw_rate_radps * dt_s;
        speed_mps = (speed_mps + acceleration_mps2 * dt_s).max(0.0);
        (timestep < gap.0 || timestep >= gap.0 + gap.1).then_some(state)
    });
    Track {
        id: TrackId(agent_idx.to_string()),
        class: AgentClass::Vehicle,
        role: TrackRole::Context,
        extent: Some(extent),
        trajectory: Trajectory::new(states.collect()),
    }
}

/// The scene in another frame.
pub(crate) fn transformed(scene: &Scene, to_from_here: &Transform2) -> Scene {
    let track = |track: &Track| Track { trajectory: track.trajectory.transformed(to_from_here), ..track.clone() };
    Scene {
        tracks: scene.tracks.iter().map(track).collect(),
        lanes: Arc::new(scene.lanes.transformed(to_from_here)),
        ..scene.clone()
    }
}
