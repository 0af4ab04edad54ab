//! The messages of djinn and a planner: one JSON object a line over the planner's standard streams.
//!
//! For each scenario djinn sends `hello`, then an `observation` whenever it needs an `action`, and at last `done`. A
//! planner answers observations and nothing else, and ends when its input does. Before its action it may `peek`, which
//! djinn answers with `futures`. A state is [x, y, heading, vx, vy]: the center of a road user, meters, its heading in
//! (-π, π], radians counterclockwise from x, and its velocity, m/s, all in the frame of the recording.

use crate::geometry::{Polyline, Transform2, Vec2};
use crate::scene::{Scene, State};
use crate::simulate::{Situation, World};
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::Serialize;

/// The version of the protocol.
pub const PROTOCOL: u32 = 1;
/// Spacing of the points of the route, meters.
const ROUTE_SPACING_M: f64 = 1.0;

/// What djinn sends.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ToPlanner {
    /// A scenario begins.
    Hello(Box<Hello>),
    /// What happened since the last observation, at first the past second. The planner answers with an action, within
    /// the time limit; for the first answer of a process it has 30 s more.
    Observation(Observation),
    /// The answer to `peek`. The planner peeks again, or answers with an action.
    Futures(Peeked),
    /// The scenario is over.
    Done(Done),
}

/// The beginning of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Hello {
    /// The version of the protocol.
    pub version: u32,
    /// The scenario, as in the corpus.
    pub scenario_id: String,
    /// The behavior that was requested of the scenario.
    pub behavior: Option<String>,
    /// Time between timesteps, seconds.
    pub dt_s: f64,
    /// How long the drive lasts at most, seconds.
    pub horizon_s: f64,
    /// Time between two observations, seconds.
    pub replan_s: f64,
    /// The name of the ego among the agents.
    pub ego_id: String,
    /// Its length, meters.
    pub length_m: f64,
    /// Its width, meters.
    pub width_m: f64,
    /// The speed that it wants to drive, m/s.
    pub target_speed_mps: f64,
    /// The way that it is to take, as points [x, y].
    pub route: Vec<[f64; 2]>,
    /// The lanes of the map.
    pub lanes: Vec<LaneLines>,
}

/// A lane.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct LaneLines {
    /// Its name in the map.
    pub id: i64,
    /// Its middle in driving direction.
    pub center: Vec<[f64; 2]>,
    /// Its left boundary; empty if the map has none.
    pub left: Vec<[f64; 2]>,
    /// Its right boundary; empty if the map has none.
    pub right: Vec<[f64; 2]>,
    /// The lanes that follow on.
    pub successors: Vec<i64>,
    /// The lane beside it on the left, in the same direction.
    pub left_neighbor: Option<i64>,
    /// The lane beside it on the right, in the same direction.
    pub right_neighbor: Option<i64>,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Observation {
    /// The present timestep, from the beginning of the past.
    pub timestep: usize,
    /// Time since the present of the scenario, seconds.
    pub time_s: f64,
    /// Everybody who is there now, the ego included.
    pub agents: Vec<Agent>,
}

/// A road user.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Agent {
    /// Its name; unique within the scenario.
    pub id: String,
    /// Kind of road user.
    pub class: String,
    /// Its length, meters.
    pub length_m: f64,
    /// Its width, meters.
    pub width_m: f64,
    /// Its states at the timesteps since the last observation, the last of them now; null where it was not there. Each
    /// is [x, y, heading, vx, vy]: its center, meters, its heading in (-π, π], radians counterclockwise from x, and its
    /// velocity, m/s, all in the frame of the recording.
    pub states: Vec<Option<[f64; 5]>>,
}

/// What may happen from the last observation on.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Peeked {
    /// The timestep of that observation.
    pub timestep: usize,
    /// Equally likely futures, in no order. Each has everybody who is there now, the ego included, in the order of the
    /// observation.
    pub futures: Vec<Vec<Future>>,
}

/// What a road user does in a future.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Future {
    /// Its name.
    pub id: String,
    /// Its states from the timestep after `timestep` on, as far as the model sees ahead, as in observations.
    pub states: Vec<[f64; 5]>,
}

/// The end of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Done {
    /// How it ended, as in the table of drives.
    pub outcome: String,
    /// More about it.
    pub why: Option<String>,
}

/// What a planner sends.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum FromPlanner {
    /// What the ego does until the next observation.
    Action(Action),
    /// Asks for futures before the action; nothing advances.
    Peek(Peek),
}

/// A question for futures that the model samples for everybody, the ego included, from the past alone: of the event of
/// the scenario they know nothing. At most 8 times an observation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Peek {
    /// How many.
    #[schemars(range(min = 1, max = 64))]
    pub n: usize,
}

/// A motion of the ego: a trajectory, or acceleration and curvature.
#[derive(Debug, Clone, PartialEq, Default, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Action {
    /// [x, y, heading] at the next timesteps, as many as there are until the next observation, or more: as in
    /// observations, and as a vehicle can drive.
    pub trajectory: Option<Vec<[f64; 3]>>,
    /// The acceleration along the heading until the next observation, m/s²; cut off at -9 and 5. It does not reverse.
    /// The center moves along the heading.
    pub acceleration_mps2: Option<f64>,
    /// The curvature of the path, 1/m, positive to the left; cut off at 0.3 and at 9 m/s² across. Left out: 0.
    pub curvature_1pm: Option<f64>,
}

/// The protocol as a JSON Schema.
pub fn protocol_schema() -> serde_json::Value {
    let mut generator = SchemaSettings::draft2020_12().into_generator();
    let [to, from] = [generator.subschema_for::<ToPlanner>(), generator.subschema_for::<FromPlanner>()];
    serde_json::json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": format!("drive_protocol.v{PROTOCOL}"),
        "description": "A message between djinn drive and a planner: one JSON object a line.",
        "anyOf": [to, from],
        "$defs": generator.take_definitions(true),
    })
}

impl Hello {
    /// The beginning of a drive.
    pub(super) fn of(situation: &Situation, [horizon_s, replan_s]: [f64; 2]) -> Self {
        let (scene, ego) = (&situation.scene, &situation.scene.tracks[situation.ego_idx]);
        let world = &scene.world_from_scene;
        let line = |line: &Polyline| line.0.iter().map(|point| pair(world.point(*point))).collect::<Vec<_>>();
        let lanes = scene.lanes.lanes().iter().map(|lane| LaneLines {
            id: lane.id.0,
            center: line(&lane.centerline),
            left: line(&lane.left),
            right: line(&lane.right),
            successors: lane.successors.iter().map(|id| id.0).collect(),
            left_neighbor: lane.left_neighbor.map(|id| id.0),
            right_neighbor: lane.right_neighbor.map(|id| id.0),
        });
        let n_points = (situation.way.route.length_m() / ROUTE_SPACING_M) as usize + 1;
        let route = (0..n_points).map(|i| situation.way.route.pose_at(i as f64 * ROUTE_SPACING_M).0);
        let extent = ego.extent_or_nominal();
        Self {
            version: PROTOCOL,
            scenario_id: situation.scenario_id.clone(),
            behavior: situation.behavior.clone(),
            dt_s: scene.dt_s,
            horizon_s,
            replan_s,
            ego_id: ego.id.0.clone(),
            length_m: extent.length_m,
            width_m: extent.width_m,
            target_speed_mps: situation.way.target_speed_mps,
            route: route.map(|point| pair(world.point(point))).collect(),
            lanes: lanes.collect(),
        }
    }
}

impl Observation {
    /// The events from timestep `first` on.
    pub(super) fn of(situation: &Situation, world: &World, first: usize) -> Self {
        let (scene, now) = (&situation.scene, world.now());
        let agent = |agent_idx: usize| {
            world.present(agent_idx)?;
            let track = &scene.tracks[agent_idx];
            let extent = track.extent_or_nominal();
            let state = |timestep: usize| world.state(agent_idx, timestep).map(|s| listed(&s, &scene.world_from_scene));
            Some(Agent {
                id: track.id.0.clone(),
                class: track.class.name().to_owned(),
                length_m: extent.length_m,
                width_m: extent.width_m,
                states: (first..=now).map(state).collect(),
            })
        };
        Self {
            timestep: now,
            time_s: (now - scene.current_timestep()) as f64 * scene.dt_s,
            agents: (0..world.n_tracks()).filter_map(agent).collect(),
        }
    }
}

impl Peeked {
    pub(super) fn of(situation: &Situation, world: &World, futures: &[Scene]) -> Self {
        let future = |scene: &Scene, agent_idx: usize| {
            world.present(agent_idx)?;
            let states = (scene.n_history..scene.n_timesteps).map_while(|t| scene.state(agent_idx, t));
            let states = states.map(|state| listed(state, &situation.scene.world_from_scene)).collect();
            Some(Future { id: situation.scene.tracks[agent_idx].id.0.clone(), states })
        };
        let all = |scene: &Scene| (0..world.n_tracks()).filter_map(|agent_idx| future(scene, agent_idx)).collect();
        Self { timestep: world.now(), futures: futures.iter().map(all).collect() }
    }
}

const fn pair(point: Vec2) -> [f64; 2] {
    [point.x, point.y]
}

fn listed(state: &State, world_from_scene: &Transform2) -> [f64; 5] {
    let State { position, heading_rad, velocity } = state.transformed(world_from_scene);
    [position.x, position.y, heading_rad, velocity.x, velocity.y]
}
