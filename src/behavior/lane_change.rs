//! Lane change: does an agent move over to the lane beside its own and stay there?

use super::kept_lane::KeptLane;
use super::lane_relation::{PARALLEL_RAD, SceneLanes};
use super::lane_tracker::{LaneMove, LaneTrace};
use super::maneuver::Maneuver;
use super::sideways::LANE_CHANGE;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Scene, Trajectory};
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
/// Who goes back within this time, seconds, has only swung out, or cut a corner.
const BACK_S: f64 = 3.0;
/// How far the center must be beyond the lane's side before it has left the lane, meters: more than the center of a
/// vehicle along a side wavers.
const HYSTERESIS_M: f64 = 0.3;
/// The two lanes run beside each other from where the change begins, at least this far before the crossing, to this far
/// after it, meters. Places this far apart are looked at.
const BESIDE_M: f64 = 8.0;
const SPACING_M: f64 = 2.0;
/// Lanes beside each other overlap by at most the first, and leave at most the second between them, meters: the sides
/// of neighbors may be drawn twice.
const MOST_OVERLAP_M: f64 = 0.8;
const MOST_GAP_M: f64 = 1.5;
/// A lane that has turned by more than the second over the first distance, meters, and turns by less than the third
/// from the crossing on, comes out of a turn, radians.
const TURN_M: f64 = 15.0;
const TURNED_RAD: f64 = 0.5;
const STRAIGHT_RAD: f64 = 0.3;
/// How far the center must move over between the lanes while it is seen, meters: less is a wavering over a line.
const LEAST_SHIFT_M: f64 = 1.0;
/// How far the center must be from the old center line for the change to have begun, meters.
const START_OFFSET_M: f64 = 0.5;
/// An agent that stays in its lane but comes closer to the lane beside it than this is a hard negative, meters.
const NEGATIVE_MARGIN_M: f64 = 0.5;

/// One agent (`agent`) changes lanes. Scenes without lanes have no events.
///
/// **Positive**: the agent's center moves from its lane into a lane beside it in the same direction (a left or right
/// neighbor by the map, or a parallel lane at its side), stays there for at least 1 s and does not go back
/// within 3 s. It has left a lane when it is more than 0.3 m beyond its side, and not before.
///
/// - The event *starts* when the center is more than 0.5 m off the old center line and stays so until it crosses.
/// - It is *complete* when the center has been in the new lane for 1 s. Crossing several lanes, each in less than
///   that, is one event: the last crossing.
/// - *What does not count*: going on to a lane that follows, forks or merges (unless the map names it as a neighbor);
///   crossing between lanes that do not run beside each other, in one direction (within 20 degrees), from the start, or
///   8 m before the crossing, to 8 m after it: that fork or merge there, that overlap by more than 0.8 m or lie more
///   than 1.5 m apart, or of which the new one only begins there; coming out of a turn (of 30 degrees in 15 m) in
///   another lane; moving over to an oncoming lane; moving over by less than 1 m while it is seen; changes that the
///   scene ends too early to confirm.
///
/// **Negative**: the agent crosses, but goes back within 3 s; or it never crosses, but its center comes within
/// 0.5 m of a lane beside its own.
///
/// Parameters: `side` (+1 left, -1 right); at the crossing `crossing_timestep`, `speed_mps` and `lateral_speed_mps`
/// (toward the new lane); `duration_s` from start to end; `margin_m` (smallest distance to the side of the lane, for
/// agents that never cross).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LaneChange {
    /// In templates and what is accepted, the agent moves over this many times as fast as drivers do at most.
    /// Default 1.
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
        let back = (BACK_S / scene.dt_s).round() as usize;
        let trace = LaneTrace::follow(lanes, trajectory, HYSTERESIS_M, stay);
        if trace.crossings.is_empty() {
            return Self::drift(scene, lanes, &trace, agent_idx).into_iter().collect();
        }
        let mut events = Vec::new();
        let mut crossings = trace.crossings.iter().peekable();
        while let Some(crossing) = crossings.next() {
            let is_soon = |next: &LaneMove<'_>| next.timestep < crossing.timestep + stay;
            let is_back = |next: &LaneMove<'_>| next.timestep < crossing.timestep + back && next.side != crossing.side;
            let back = crossings.next_if(|next| is_back(next));
            let goes_on = crossings.peek().is_some_and(|next| is_soon(next));
            let (label, end) = match back {
                Some(back) => (EventLabel::Negative, back.timestep),
                None if goes_on || crossing.last_followed < crossing.timestep + stay => continue,
                None => (EventLabel::Positive, crossing.timestep + stay),
            };
            let start = trace.departure(crossing, START_OFFSET_M);
            if is_between_neighbors(lanes, crossing, trajectory, start) != Some(true) {
                continue;
            }
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

/// Whether the lanes of a crossing run beside each other around it, neither comes out of a turn there, and the agent
/// moves over between them, from timestep `start` on.
fn is_between_neighbors(
    lanes: &SceneLanes<'_>,
    crossing: &LaneMove<'_>,
    trajectory: &Trajectory,
    start: usize,
) -> Option<bool> {
    let [old, new] = [crossing.from, crossing.lane].map(|lane| KeptLane::from_lane(lanes, lane));
    let toward_m =
        |timestep: usize| old.project(trajectory.get(timestep)?.position).map(|place| crossing.side * place.offset_m);
    let nearest_m = (0..crossing.timestep).filter_map(toward_m).reduce(f64::min).unwrap_or(f64::INFINITY);
    let farthest_m = (crossing.timestep..=crossing.last_followed).filter_map(toward_m).reduce(f64::max)?;
    let station_m = new.project(crossing.position)?.station_m;
    let started_m = new.project(trajectory.get(start)?.position)?.station_m;
    let from_m = started_m.min(station_m - BESIDE_M);
    let n_places = ((station_m + BESIDE_M - from_m) / SPACING_M).ceil() as usize;
    let run_beside =
        (0..=n_places).all(|i| run_beside(&old, &new, from_m + i as f64 * SPACING_M, crossing.side) == Some(true));
    let turn_rad = |lane: &KeptLane, from_m: f64, to_m: f64| {
        let station_m = lane.project(crossing.position)?.station_m;
        let (from, to) = lane.heading_at(station_m + from_m).zip(lane.heading_at(station_m + to_m))?;
        Some(angle_difference(to, from).abs())
    };
    let comes_out = turn_rad(&old, -TURN_M, 0.0)? > TURNED_RAD && turn_rad(&new, 0.0, BESIDE_M)? < STRAIGHT_RAD;
    Some(run_beside && !comes_out && farthest_m - nearest_m >= LEAST_SHIFT_M)
}

/// Whether `new` runs on this side of `old` at this distance along it, in its direction.
fn run_beside(old: &KeptLane, new: &KeptLane, station_m: f64, side: f64) -> Option<bool> {
    let center = new.point_at(station_m).filter(|_| new.is_mapped(station_m))?;
    let place = old.project(center)?;
    // Of adjacent lanes, the center of each is half a width beyond the side of the other: their distance in sum.
    let overlap_m = place.offset_m.abs() - old.beyond_m(center, side)? - new.beyond_m(place.point, -side)?;
    let is_parallel = angle_difference(place.heading_rad, new.heading_at(station_m)?).abs() < PARALLEL_RAD;
    Some(is_parallel && place.offset_m * side > 0.0 && (-MOST_GAP_M..=MOST_OVERLAP_M).contains(&overlap_m))
}

impl Behavior for LaneChange {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["side"]
    }

    fn is_as_driven(&self, event: &BehaviorEvent) -> bool {
        LANE_CHANGE.of(self.hurry, 0.0).holds(event)
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
