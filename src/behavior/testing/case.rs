//! Example scenes as TOML files: a scene in a few lines, and the events to be found in it.
//!
//! See `tests/fixtures/behavior/README.md` for the format.

use super::motion::{Segment, Start, drive};
use crate::behavior::{BehaviorConfig, EventLabel};
use crate::geometry::{Polyline, Transform2, Vec2};
use crate::scene::{
    AgentClass, Dataset, Extent, Lane, LaneAttributes, LaneGraph, LaneId, Scene, SceneSource, SituationKind, Split,
    State, Track, TrackId, TrackRole, Trajectory,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An example scene with the events that are to be found in it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Case {
    /// The behavior to look for, if not the folder's one with its defaults.
    pub(crate) behavior: Option<BehaviorConfig>,
    pub(crate) scene: SceneSpec,
    /// All events, in the behavior's order.
    #[serde(default)]
    pub(crate) events: Vec<ExpectedEvent>,
}

/// An event that must be found.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExpectedEvent {
    pub(crate) label: EventLabel,
    pub(crate) roles: BTreeMap<String, String>,
    pub(crate) start_timestep: Option<usize>,
    pub(crate) end_timestep: Option<usize>,
    /// The subject's track.
    pub(crate) subject: Option<String>,
    /// Values to two decimals.
    #[serde(default)]
    pub(crate) parameters: BTreeMap<String, f64>,
    /// Parameters that must not be there.
    #[serde(default)]
    pub(crate) absent: Vec<String>,
}

/// A scene written by hand.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SceneSpec {
    #[serde(default = "default_dt_s")]
    dt_s: f64,
    #[serde(default = "default_n_history")]
    n_history: usize,
    #[serde(default = "default_n_timesteps")]
    n_timesteps: usize,
    #[serde(default = "default_dataset")]
    dataset: Dataset,
    /// The first agent is the ego of the scene.
    agents: Vec<AgentSpec>,
    #[serde(default)]
    lanes: Vec<LaneSpec>,
}

const fn default_dt_s() -> f64 {
    0.1
}

const fn default_n_history() -> usize {
    10
}

const fn default_n_timesteps() -> usize {
    40
}

const fn default_dataset() -> Dataset {
    Dataset::Interaction
}

/// An agent: its start and its motion.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct AgentSpec {
    id: String,
    #[serde(default = "default_class")]
    class: AgentClass,
    #[serde(default = "default_role")]
    role: TrackRole,
    /// [length, width]; 4.5 by 1.8 m if not given.
    size_m: Option<[f64; 2]>,
    start: Start,
    #[serde(default)]
    segments: Vec<Segment>,
    /// Ranges of timesteps, first and last, at which the agent is not tracked.
    #[serde(default)]
    untracked: Vec<[usize; 2]>,
}

const fn default_role() -> TrackRole {
    TrackRole::Context
}

const fn default_class() -> AgentClass {
    AgentClass::Vehicle
}

/// The lanes of a text such as `lanes = [{ id = 1, centerline = [[0, 0], [50, 0]] }]`.
pub(crate) fn lane_graph(text: &str) -> LaneGraph {
    #[derive(Deserialize)]
    struct Lanes {
        lanes: Vec<LaneSpec>,
    }
    let Lanes { lanes } = toml::from_str(text).expect("lanes");
    LaneGraph::new(lanes.iter().map(LaneSpec::build).collect())
}

/// A lane: a center line and, if `width_m` is given, boundaries beside it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LaneSpec {
    pub(crate) id: i64,
    pub(crate) centerline: Vec<[f64; 2]>,
    pub(crate) width_m: Option<f64>,
    #[serde(default)]
    pub(crate) successors: Vec<i64>,
    #[serde(default)]
    pub(crate) predecessors: Vec<i64>,
    pub(crate) left_neighbor: Option<i64>,
    pub(crate) right_neighbor: Option<i64>,
    #[serde(default = "default_one_way")]
    pub(crate) one_way: bool,
    /// Further tags of the map, such as the rules in which the lane has a part.
    #[serde(default)]
    pub(crate) tags: BTreeMap<String, String>,
}

const fn default_one_way() -> bool {
    true
}

impl SceneSpec {
    /// The scene, named `name`.
    pub(crate) fn build(&self, name: &str) -> Scene {
        let source = SceneSource {
            dataset: self.dataset,
            version: String::new(),
            split: Split::Val,
            place: "hand".to_owned(),
            file: String::new(),
            case_id: name.to_owned(),
            first_frame: "0".to_owned(),
            situation: SituationKind::Recorded,
            continues: None,
        };
        Scene {
            id: name.into(),
            source,
            dt_s: self.dt_s,
            n_timesteps: self.n_timesteps,
            n_history: self.n_history,
            world_from_scene: Transform2::IDENTITY,
            ego_idx: 0,
            tracks: self.agents.iter().map(|agent| agent.build(self.dt_s, self.n_timesteps)).collect(),
            map_id: None,
            lanes: Arc::new(LaneGraph::new(self.lanes.iter().map(LaneSpec::build).collect())),
        }
    }
}

impl AgentSpec {
    fn build(&self, dt_s: f64, n_timesteps: usize) -> Track {
        let [length_m, width_m] = self.size_m.unwrap_or([4.5, 1.8]);
        let is_tracked = |t: usize| !self.untracked.iter().any(|[first, last]| (*first..=*last).contains(&t));
        let states: Vec<State> = drive(&self.start, &self.segments, dt_s, n_timesteps);
        Track {
            id: TrackId(self.id.clone()),
            class: self.class,
            role: self.role,
            extent: Some(Extent { length_m, width_m }),
            trajectory: Trajectory::new(
                states.into_iter().enumerate().map(|(t, state)| is_tracked(t).then_some(state)).collect(),
            ),
        }
    }
}

impl LaneSpec {
    pub(crate) fn build(&self) -> Lane {
        let points: Vec<Vec2> = self.centerline.iter().map(|[x, y]| Vec2::new(*x, *y)).collect();
        let side = |sign: f64| {
            let offset = |width_m: f64| {
                (0..points.len())
                    .map(|i| {
                        let (before, after) = (points[i.saturating_sub(1)], points[(i + 1).min(points.len() - 1)]);
                        let left = Vec2::from_angle((after - before).angle() + std::f64::consts::FRAC_PI_2);
                        points[i] + left * (sign * width_m / 2.0)
                    })
                    .collect()
            };
            Polyline(self.width_m.map_or_else(Vec::new, offset))
        };
        let ids = |ids: &[i64]| ids.iter().copied().map(LaneId).collect();
        Lane {
            id: LaneId(self.id),
            left: side(1.0),
            right: side(-1.0),
            centerline: Polyline(points),
            successors: ids(&self.successors),
            predecessors: ids(&self.predecessors),
            left_neighbor: self.left_neighbor.map(LaneId),
            right_neighbor: self.right_neighbor.map(LaneId),
            attributes: LaneAttributes { one_way: self.one_way, tags: self.tags.clone(), ..LaneAttributes::default() }
                .into(),
        }
    }
}

/// The cases in a folder below `tests/fixtures`, as (name, text), by name.
pub(crate) fn cases_in(folder: &str) -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(folder);
    let entries = fs_err::read_dir(&folder).expect("the folder of example scenes");
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    let name = |path: &Path| path.file_stem().expect("a file").to_string_lossy().into_owned();
    paths.iter().map(|path| (name(path), fs_err::read_to_string(path).expect("readable"))).collect()
}
