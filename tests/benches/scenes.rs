//! Scenes of any size: vehicles that drive straight on along a grid of lanes.

use djinn::geometry::{Polyline, Transform2, Vec2};
use djinn::scene::{
    AgentClass, Dataset, Extent, Lane, LaneGraph, Scene, SceneSource, SituationKind, Split, State, Track, TrackId,
    TrackRole, Trajectory,
};
use std::sync::Arc;

const DT_S: f64 = 0.1;

/// A scene in INTERACTION's shape: `n_agents` vehicles, `n_timesteps` of which `n_history` are observed, `n_lanes`
/// lanes of ten points.
pub(crate) fn scene(n_agents: usize, n_timesteps: usize, n_history: usize, n_lanes: usize) -> Scene {
    let track = |idx: usize| {
        let (column, row) = ((idx % 8) as f64, (idx / 8) as f64);
        let speed_mps = 5.0 + (idx % 5) as f64;
        let state = |timestep: usize| State {
            position: Vec2::new(column * 12.0 + speed_mps * DT_S * timestep as f64, row * 3.5),
            heading_rad: 0.0,
            velocity: Vec2::new(speed_mps, 0.0),
        };
        Track {
            id: TrackId(idx.to_string()),
            class: AgentClass::Vehicle,
            role: TrackRole::Context,
            extent: Some(Extent { length_m: 4.5, width_m: 1.8 }),
            trajectory: Trajectory::new((0..n_timesteps).map(|timestep| Some(state(timestep))).collect()),
        }
    };
    let lane = |idx: usize| {
        let (column, row) = ((idx % 10) as f64, (idx / 10) as f64);
        let line = |offset_m: f64| {
            Polyline((0..10).map(|i| Vec2::new(column * 18.0 + f64::from(i) * 2.0, row * 3.5 + offset_m)).collect())
        };
        Lane::unconnected(idx as i64, line(0.0), [1.75, -1.75].map(line))
    };
    Scene {
        id: format!("interaction/train/Grid/{n_agents}").as_str().into(),
        source: SceneSource {
            dataset: Dataset::Interaction,
            version: String::new(),
            split: Split::Train,
            place: "Grid".to_owned(),
            file: String::new(),
            case_id: n_agents.to_string(),
            first_frame: String::new(),
            situation: SituationKind::Recorded,
            continues: None,
        },
        dt_s: DT_S,
        n_timesteps,
        n_history,
        world_from_scene: Transform2::IDENTITY,
        ego_idx: 0,
        tracks: (0..n_agents).map(track).collect(),
        map_id: None,
        lanes: Arc::new(LaneGraph::new((0..n_lanes).map(lane).collect())),
    }
}
