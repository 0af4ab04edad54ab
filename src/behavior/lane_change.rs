//! Lane change: does an agent move over to the lane beside its own and stay there?

use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use super::lane_tracker::{LaneMove, LaneTrace};
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "lane_change";
/// The agent that changes lanes.
pub(super) const ROLES: &[&str] = &["agent"];
/// Names of the parameters of its events, defined at [`LaneChange`].
pub(super) const PARAMETERS: &[&str] =
    &["side", "crossing_timestep", "speed_mps", "lateral_speed_mps", "duration_s", "margin_m"];

/// How long the center must stay in the new lane, seconds.
const MIN_STAY_S: f64 = 1.0;
/// How far the center must be beyond the lane's side before it has left the lane, meters: more than the center of a
/// vehicle along a side wavers.
const HYSTERESIS_M: f64 = 0.3;
/// Lanes go on beside each other if they are at least this far apart up to this far before and after the crossing,
/// meters.
const APART_M: f64 = 2.0;
const BESIDE_M: f64 = 8.0;
/// A lane that has turned by more than the first over that distance, and turns by less than the second from the
/// crossing on, comes out of a turn, radians.
const TURNED_RAD: f64 = 0.5;
const STRAIGHT_RAD: f64 = 0.3;
/// How far the center must be from the old center line for the change to have begun, meters.
const START_OFFSET_M: f64 = 0.5;
/// An agent that stays in its lane but comes closer to the lane beside it than this is a hard negative, meters.
const NEGATIVE_MARGIN_M: f64 = 0.5;

/// One agent (`agent`) changes lanes. Scenes without lanes have no events.
///
/// **Positive**: the agent's center moves from its lane into a lane beside it in the same direction (a left or right
/// neighbor by the map, or a parallel lane at its side) and stays there for at least 1 s. It has left a lane
/// when it is more than 0.3 m beyond its side, and not before.
///
/// - The event *starts* when the center is more than 0.5 m off the old center line and stays so until it crosses.
/// - It is *complete* when the center has been in the new lane for 1 s. Crossing several lanes, each in less than
///   that, is one event: the last crossing.
/// - *What does not count*: going on to a lane that follows, forks or merges (unless the map names it as a neighbor);
///   crossing between lanes that are less than 2 m apart 8 m before or after, as where they fork, merge or overlap;
///   coming out of a turn in another lane; moving over to an oncoming lane; weaving within 0.3 m of a line; changes
///   that the scene ends too early to confirm.
///
/// **Negative**: the agent crosses, but goes back within 1 s; or it never crosses, but its center comes within
/// 0.5 m of a lane beside its own.
///
/// Parameters: `side` (+1 left, -1 right); at the crossing `crossing_timestep`, `speed_mps` and `lateral_speed_mps`
/// (toward the new lane); `duration_s` from start to end; `margin_m` (smallest distance to the side of the lane, for
/// agents that never cross).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LaneChange {
    /// In templates, the agent moves over this many times as fast as drivers do at most. Default 1.
    #[schemars(range(min = 0.5, max = 3.0))]
    pub hurry: f64,
}

impl Default for LaneChange {
    fn default() -> Self {
        Self { hurry: 1.0 }
    }
}

impl LaneChange {
    fn detect_agent<'a>(scene: &Scene, lanes: &'a SceneLanes<'a>, agent_idx: usize) -> Vec<BehaviorEvent> {
        let trajectory = &scene.tracks[agent_idx].trajectory;
        let stay = (MIN_STAY_S / scene.dt_s - 1e-9).ceil().max(1.0) as usize;
        let trace = LaneTrace::follow(lanes, trajectory, HYSTERESIS_M, stay);
        if trace.crossings.is_empty() {
            return Self::drift(scene, lanes, &trace, agent_idx).into_iter().collect();
        }
        let mut events = Vec::new();
        let mut crossings = trace.crossings.iter().peekable();
        while let Some(crossing) = crossings.next() {
            let is_soon = |next: &LaneMove<'_>| next.timestep < crossing.timestep + stay;
            let back = crossings.next_if(|next| is_soon(next) && next.side != crossing.side);
            let goes_on = crossings.peek().is_some_and(|next| is_soon(next));
            if !is_between_neighbors(lanes, crossing) {
                continue;
            }
            let (label, end) = match back {
                Some(back) => (EventLabel::Negative, back.timestep),
                None if goes_on || crossing.last_followed < crossing.timestep + stay => continue,
                None => (EventLabel::Positive, crossing.timestep + stay),
            };
            let start = trace.departure(crossing, START_OFFSET_M);
            events.push(Self::crossing_event(scene, agent_idx, crossing, label, start, end));
        }
        events
    }

    fn crossing_event(
        scene: &Scene,
        agent_idx: usize,
        crossing: &LaneMove<'_>,
        label: EventLabel,
        start: usize,
        end: usize,
    ) -> BehaviorEvent {
        let state = scene.state(agent_idx, crossing.timestep);
        let across = Vec2::from_angle(crossing.heading_rad);
        BehaviorEvent::new((ID, ROLES), scene, label, &[agent_idx], start..=end)
            .with("side", crossing.side)
            .with("crossing_timestep", crossing.timestep as f64)
            .with("speed_mps", state.map(crate::scene::State::speed_mps))
            .with("lateral_speed_mps", state.map(|s| crossing.side * across.cross(s.velocity)))
            .with("duration_s", (end - start) as f64 * scene.dt_s)
    }

    /// The hard negative of an agent that nears a lane beside its own without crossing.
    fn drift<'a>(
        scene: &Scene,
        lanes: &'a SceneLanes<'a>,
        trace: &LaneTrace<'a>,
        agent_idx: usize,
    ) -> Option<BehaviorEvent> {
        let drifts: Vec<_> = trace.drifts(lanes, NEGATIVE_MARGIN_M).collect();
        let (first, last) = (drifts.first()?, drifts.last()?);
        let nearest = drifts.iter().min_by(|a, b| a.margin_m.total_cmp(&b.margin_m))?;
        let event =
            BehaviorEvent::new((ID, ROLES), scene, EventLabel::Negative, &[agent_idx], first.timestep..=last.timestep)
                .with("side", nearest.side)
                .with("margin_m", nearest.margin_m)
                .with("duration_s", (last.timestep - first.timestep) as f64 * scene.dt_s);
        Some(event)
    }
}

/// Whether the lanes of a crossing go on beside each other, before and after it, and neither comes out of a turn there.
fn is_between_neighbors(lanes: &SceneLanes<'_>, crossing: &LaneMove<'_>) -> bool {
    let [old, new] = [crossing.from, crossing.lane].map(|lane| KeptLane::from_lane(lanes, lane));
    let heading_rad = |lane: &KeptLane, ahead_m: f64| {
        let station_m = lane.project(crossing.position)?.station_m + ahead_m;
        lane.project(lane.point_at(station_m)?).map(|place| place.heading_rad)
    };
    let apart_m = |ahead_m: f64| {
        let station_m = new.project(crossing.position)?.station_m + ahead_m;
        old.project(new.point_at(station_m)?).map(|place| place.offset_m.abs())
    };
    let turn_rad = |lane: &KeptLane, from_m: f64, to_m: f64| {
        let (from, to) = heading_rad(lane, from_m).zip(heading_rad(lane, to_m))?;
        Some(angle_difference(to, from).abs())
    };
    let turned = turn_rad(&old, -BESIDE_M, 0.0).is_some_and(|turn| turn > TURNED_RAD);
    let comes_out = turned && turn_rad(&new, 0.0, BESIDE_M).is_some_and(|turn| turn < STRAIGHT_RAD);
    let is_apart = |ahead_m: &f64| apart_m(*ahead_m).is_some_and(|apart_m| apart_m >= APART_M);
    [-BESIDE_M, 0.0, BESIDE_M].iter().all(is_apart) && !comes_out
}

impl Behavior for LaneChange {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["side"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.first().map_or_else(Vec::new, |agent_idx| self.changes(scene, *agent_idx))
    }

    /// Agents come in the order of tracks; the events of each agent come by time.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        if scene.lanes.is_empty() {
            return Vec::new();
        }
        let lanes = SceneLanes::new(&scene.lanes);
        let considered = (0..scene.tracks.len()).filter(|i| scene.tracks[*i].class.is_motorized());
        considered.flat_map(|agent_idx| Self::detect_agent(scene, &lanes, agent_idx)).collect()
    }
}
