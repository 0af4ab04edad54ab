//! Running a stop line: does a vehicle pass the line of an all-way stop without stopping?

use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::scene::{LaneDuty, Scene};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "runs_stop_line";
/// The vehicle that does not stop.
pub(super) const ROLES: &[&str] = &["agent"];
/// Names of the parameters of its events, defined at [`RunsStopLine`].
pub(super) const PARAMETERS: &[&str] = &["speed_mps", "min_speed_mps"];

/// A vehicle that rolled, but was never slower than this, is a hard negative, m/s; a slower one has stopped.
const STOPPED_MPS: f64 = 0.5;

/// The vehicle must have stopped over this distance before the line, meters, and it must be tracked there: less hides
/// stops behind a waiting vehicle, more loses vehicles at the edge of the recording.
const APPROACH_M: f64 = 10.0;

/// One vehicle (`agent`) passes a stop line without stopping.
///
/// The line is the end of a lane that the map's rule of an all-way stop names as one that yields (Lanelet2's regulatory
/// element `all_way_stop`). The states of signals are in no recording, and the rule of a right of way does not say
/// whether its sign demands a stop, so neither counts.
///
/// **Positive**: the front of the vehicle passes the end of such a lane, along the lanes that it turns out to keep, and
/// over the last 10 m before it the vehicle was never slower than 2.2 m/s. It is tracked over all of these 10 m.
///
/// The event *starts* at the first timestep on these 10 m and is *complete* when the front has passed the line.
///
/// *What does not count*: who comes into the scene on the way to the line, since it may have stopped before; maps
/// without such rules.
///
/// **Negative**: the same of who was slower than 2.2 m/s, but never slower than 0.5 m/s: it rolls through.
///
/// Parameters: `speed_mps` (at the line), `min_speed_mps` (the lowest over the 10 m).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RunsStopLine {
    /// Who was slower than this has stopped as most drivers do, by rolling, m/s. Default 2.2 (8 km/h).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_rolling_mps: f64,
}

impl Default for RunsStopLine {
    fn default() -> Self {
        Self { max_rolling_mps: 2.2 }
    }
}

impl RunsStopLine {
    fn events(&self, scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Vec<BehaviorEvent> {
        let Some(lane) = KeptLane::of(scene, lanes, agent_idx) else { return Vec::new() };
        let track = &scene.tracks[agent_idx];
        let half_length_m = track.extent_or_nominal().length_m / 2.0;
        let states = track.trajectory.valid().filter(|(_, state)| state.is_finite());
        let fronts: Vec<Front> = states
            .filter_map(|(timestep, state)| {
                let station_m = lane.project(state.position)?.station_m + half_length_m;
                Some(Front { timestep, station_m, speed_mps: state.speed_mps() })
            })
            .collect();
        let own = lane.ids().iter().filter_map(|id| lanes.get(*id)).map(|lane| lane.lane);
        let lines = own.filter(|lane| lane.attributes.duties().any(|(_, duty)| duty == LaneDuty::Stops));
        let lines_m = lines.filter_map(|own| Some(lane.project(*own.centerline.0.last()?)?.station_m));
        lines_m.filter_map(|line_m| self.event(scene, agent_idx, &fronts, line_m)).collect()
    }

    fn event(&self, scene: &Scene, agent_idx: usize, fronts: &[Front], line_m: f64) -> Option<BehaviorEvent> {
        let passed = fronts.iter().position(|front| front.station_m >= line_m)?;
        let first = fronts[..passed].iter().rposition(|front| front.station_m < line_m - APPROACH_M)? + 1;
        let approach = &fronts[first..=passed];
        let min_mps = approach.iter().map(|front| front.speed_mps).reduce(f64::min)?;
        let label = match min_mps >= self.max_rolling_mps {
            true => EventLabel::Positive,
            false if min_mps >= STOPPED_MPS => EventLabel::Negative,
            false => return None,
        };
        let timesteps = approach[0].timestep..=fronts[passed].timestep;
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &[agent_idx], timesteps)
            .with("speed_mps", fronts[passed].speed_mps)
            .with("min_speed_mps", min_mps);
        Some(event)
    }
}

/// The front of a vehicle along its lane at a timestep.
struct Front {
    timestep: usize,
    station_m: f64,
    speed_mps: f64,
}

impl Behavior for RunsStopLine {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["speed_mps", "min_speed_mps"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.first().map_or_else(Vec::new, |agent_idx| self.drives_through(scene, *agent_idx))
    }

    /// Agents come in the order of tracks; the events of an agent in the order of its lanes.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        if !scene.lanes.lanes().iter().any(|lane| lane.attributes.duties().any(|(_, duty)| duty == LaneDuty::Stops)) {
            return Vec::new();
        }
        let considered = (0..scene.tracks.len()).filter(|idx| scene.tracks[*idx].class.is_motorized());
        considered.flat_map(|agent_idx| self.events(scene, &lanes, agent_idx)).collect()
    }
}
