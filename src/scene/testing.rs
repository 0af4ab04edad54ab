//! Scenes for tests, whose names and numbers say what to expect.

use super::*;
use crate::geometry::{Polyline, Transform2, Vec2};
use std::sync::Arc;

/// A vehicle that drives a circular arc: `speed_mps` along a path of curvature `curvature_1pm` from (`x`, `y`) with
/// `heading_rad`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drive {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) heading_rad: f64,
    pub(crate) speed_mps: f64,
    pub(crate) curvature_1pm: f64,
}

impl Drive {
    /// Straight on at constant speed.
    pub(crate) const fn straight(x: f64, y: f64, heading_rad: f64, speed_mps: f64) -> Self {
        Self { x, y, heading_rad, speed_mps, curvature_1pm: 0.0 }
    }

    fn state(&self, elapsed_s: f64) -> State {
        let turned = self.curvature_1pm * self.speed_mps * elapsed_s;
        let chord = if turned.abs() < 1e-9 {
            Vec2::new(self.speed_mps * elapsed_s, 0.0)
        } else {
            Vec2::new(turned.sin(), 1.0 - turned.cos()) * (1.0 / self.curvature_1pm)
        };
        let heading_rad = crate::geometry::wrap_angle(self.heading_rad + turned);
        State {
            position: Vec2::new(self.x, self.y) + chord.rotated(self.heading_rad),
            heading_rad,
            velocity: Vec2::from_angle(heading_rad) * self.speed_mps,
        }
    }
}

pub(crate) fn vehicle(id: &str, states: impl Iterator<Item = Option<State>>) -> Track {
    Track {
        id: id.into(),
        class: AgentClass::Vehicle,
        role: TrackRole::Context,
        extent: Some(Extent { length_m: 4.5, width_m: 1.8 }),
        trajectory: Trajectory::new(states.collect()),
    }
}

/// A scene of vehicles `1`, `2`, … at 10 Hz with 4 observed of 12 timesteps, and one straight lane of 61 points.
pub(crate) fn scene(drives: &[Drive]) -> Scene {
    let (n_timesteps, n_history, dt_s) = (12, 4, 0.1);
    let track = |(idx, drive): (usize, &Drive)| {
        vehicle(&(idx + 1).to_string(), (0..n_timesteps).map(|t| Some(drive.state(t as f64 * dt_s))))
    };
    let line = |y: f64| Polyline((0..61).map(|i| Vec2::new(f64::from(i) * 2.0 - 40.0, y)).collect());
    let lane = Lane::unconnected(7, line(0.0), [1.75, -1.75].map(line));
    Scene {
        id: "interaction/train/Test/1".into(),
        source: SceneSource {
            dataset: Dataset::Interaction,
            version: "v1.2".to_owned(),
            split: Split::Train,
            place: "Test".to_owned(),
            file: "Test_train.csv".to_owned(),
            case_id: "1".to_owned(),
            first_frame: "1".to_owned(),
            situation: SituationKind::Recorded,
            continues: None,
        },
        dt_s,
        n_timesteps,
        n_history,
        world_from_scene: Transform2::IDENTITY,
        ego_idx: 0,
        tracks: drives.iter().enumerate().map(track).collect(),
        map_id: Some("Test".into()),
        lanes: Arc::new(LaneGraph::new(vec![lane])),
    }
}

/// The provenance of an unguided sample of a scene.
pub(crate) fn provenance(scene_id: &str) -> Provenance {
    Provenance {
        scene_id: scene_id.into(),
        observation: "predictive".to_owned(),
        edit_tau: None,
        checkpoint: "d".to_owned(),
        classifier: None,
        seed: 1,
        sample_idx: 0,
        probability: None,
        guidance: GuidanceTag {
            kind: GuidanceTag::NONE.to_owned(),
            level: GuidanceLevel::UNGUIDED,
            roles: Roles::default(),
        },
        sampler: "heun-10".to_owned(),
        ego_driver: None,
        settings: String::new(),
    }
}

/// Removes the states of a track at the timesteps where `gone` says so.
pub(crate) fn without_states(mut scene: Scene, agent_idx: usize, gone: impl Fn(usize) -> bool) -> Scene {
    let trajectory = &scene.tracks[agent_idx].trajectory;
    let kept = trajectory.entries().iter().enumerate().map(|(t, state)| state.filter(|_| !gone(t))).collect();
    scene.tracks[agent_idx].trajectory = Trajectory::new(kept);
    scene
}
