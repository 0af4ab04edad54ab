//! A recorded traffic scene.

use super::{Dataset, LaneGraph, MapId, SceneId, State, Track, TrackId, Trajectory};
use crate::geometry::{Transform2, Vec2};
use crate::settings::named;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The split of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// For training.
    Train,
    /// Held out, with futures.
    Val,
    /// Held out, futures not given.
    Test,
    /// Not stated by the source.
    Unsplit,
}

named! { Split { Train = "train", Val = "val", Test = "test", Unsplit = "unsplit" } }

/// How the past of a scene came about.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum SituationKind {
    /// It was recorded.
    #[default]
    Recorded,
    /// A closed loop led to it from a recorded scene.
    Continued,
    /// A closed loop led to it from a recorded scene into which road users were put.
    Populated,
}

named! { SituationKind { Recorded = "recorded", Continued = "continued", Populated = "populated" } }

/// Why a scene cannot be used, in words that follow its name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct UnfitScene(pub String);

/// The origin of a scene in its dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneSource {
    /// The dataset.
    pub dataset: Dataset,
    /// The dataset's version or layout, such as `v1.1`, `v1.2`; empty if there is only one.
    pub version: String,
    /// The split.
    pub split: Split,
    /// City or location, as the dataset names it: `PIT`, `DR_CHN_Merging_ZS0`.
    pub place: String,
    /// The file within its folder or archive, with `/` between parts.
    pub file: String,
    /// The case, sequence or scenario id within the file, as written.
    pub case_id: String,
    /// The first frame or timestamp of the scene as written in the file; of tables, its time in steps of 0.1 s.
    pub first_frame: String,
    /// How its past came about.
    pub situation: SituationKind,
    /// The recorded scene from which it goes on; `None` if it was recorded itself.
    pub continues: Option<SceneId>,
}

/// A window of recorded traffic. Every track has the same number of timesteps; coordinates are in the scene frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Unique name.
    pub id: SceneId,
    /// Where it came from.
    pub source: SceneSource,
    /// Time between timesteps, seconds.
    pub dt_s: f64,
    /// Number of timesteps, history and future.
    pub n_timesteps: usize,
    /// Number of observed timesteps t_obs: timesteps 0 to `n_history` - 1 are the past.
    pub n_history: usize,
    /// From the scene frame to the recording's frame. The scene frame has its origin at the ego's position at
    /// timestep `n_history` - 1 and its x axis along the ego's heading there.
    pub world_from_scene: Transform2,
    /// Index into `tracks` of the ego agent.
    pub ego_idx: usize,
    /// The tracks.
    pub tracks: Vec<Track>,
    /// The map the lanes are from; `None` if the dataset was ingested without maps.
    pub map_id: Option<MapId>,
    /// The lanes near the scene, in the scene frame.
    pub lanes: Arc<LaneGraph>,
}

impl Scene {
    /// The last observed timestep, t_obs - 1: the present.
    pub const fn current_timestep(&self) -> usize {
        self.n_history.saturating_sub(1)
    }

    /// A hash of its name and its frame, by which the same scene is recognized if it is recorded twice; other scenes of
    /// its name have another frame.
    pub fn identity(&self) -> u128 {
        let Vec2 { x, y } = self.world_from_scene.translation;
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.id.0.as_bytes());
        [x, y, self.world_from_scene.rotation_rad()].iter().for_each(|number| _ = hasher.update(&number.to_le_bytes()));
        let mut first = [0; 16];
        first.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
        u128::from_le_bytes(first)
    }

    /// The ego track.
    pub fn ego(&self) -> &Track {
        &self.tracks[self.ego_idx]
    }

    /// The index of the track with this id.
    pub fn track_idx(&self, id: &TrackId) -> Option<usize> {
        self.tracks.iter().position(|track| track.id == *id)
    }

    /// The state of a track at `timestep`, if it was tracked then.
    pub fn state(&self, agent_idx: usize, timestep: usize) -> Option<&State> {
        self.tracks.get(agent_idx).and_then(|track| track.trajectory.get(timestep))
    }

    /// The scene with this number of timesteps: shorter, or with nobody tracked at the further ones.
    #[must_use]
    pub fn lasting(&self, n_timesteps: usize) -> Self {
        let mut scene = Self { n_timesteps, ..self.clone() };
        for track in &mut scene.tracks {
            let mut states = track.trajectory.entries().to_vec();
            states.resize(n_timesteps, None);
            track.trajectory = Trajectory::new(states);
        }
        scene
    }

    /// Whether the future after `n_history` is recorded (test splits have none).
    pub const fn has_future(&self) -> bool {
        self.n_timesteps > self.n_history
    }
}
