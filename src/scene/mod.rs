//! The nouns of traffic: scenes, tracks, lanes, observation masks, generated scenarios. No files, no tensors.
//!
//! A scene holds all lanes that its agents can reach from their observed states, so that no check and no export lacks
//! the road under a vehicle. [`Dataset::facts`] is the table of differences between datasets other than their formats.

mod agent;
mod agent_ref;
mod dataset;
mod edit;
mod guidance_level;
mod ids;
mod lane_graph;
mod lane_tags;
mod moments;
mod motion;
mod motion_heading;
mod observation_mask;
mod roles;
mod scenario;
#[expect(clippy::module_inception, reason = "the folder is named for its main type")]
mod scene;
#[cfg(test)]
pub(crate) mod testing;
mod track;
mod trajectory;
mod velocity;

pub use agent::{AgentClass, Extent};
pub use agent_ref::AgentRef;
pub use dataset::{Benchmark, Dataset, DatasetFacts, INGESTED_DT_S, MissRule};
pub use edit::{EditKind, Meet, ScaleSpeed, SceneEdit, SetPositions, Shift, ShiftTime, TimedPoint};
pub use guidance_level::{GuidanceLevel, LevelAxis};
pub use ids::{LaneId, MapId, SceneId, TrackId};
pub use lane_graph::{Lane, LaneAttributes, LaneDuty, LaneGraph, TurnDirection};
pub use moments::moments;
pub use motion::STANDING_STEP_M;
pub use motion_heading::motion_heading;
pub use observation_mask::ObservationMask;
pub use roles::Roles;
pub use scenario::{GuidanceTag, Provenance, Scenario};
pub use scene::{Scene, SceneSource, SituationKind, Split, UnfitScene};
pub use track::{Track, TrackRole};
pub use trajectory::{Derivation, RecordedPosition, State, Trajectory};
pub use velocity::velocity_at;
