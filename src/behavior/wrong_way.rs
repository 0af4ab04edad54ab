//! Wrong way: does a vehicle drive against the direction of its lane for some time?

use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Scene, State, Track};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_4, PI};
use std::ops::RangeInclusive;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "wrong_way";
/// The vehicle that drives the wrong way.
pub(super) const ROLES: &[&str] = &["agent"];
/// Names of the parameters of its events, defined at [`WrongWay`].
pub(super) const PARAMETERS: &[&str] = &["duration_s", "mean_speed_mps", "path_m"];

/// A vehicle drives against a lane if it points opposite to it within this, radians.
const OPPOSITE_RAD: f64 = FRAC_PI_4;

/// The vehicle drives forward at least this fast, m/s: maneuvering ones are slower.
const MIN_SPEED_MPS: f64 = 2.0;
/// A time that is too short, but at least this part of the least one, is a hard negative (0.5 of 1.5 s).
const NEGATIVE_PART: f64 = 3.0;

/// One vehicle (`agent`) drives against the direction of the lane that it is in.
///
/// **Positive**: over at least 1.5 s without a break, all of
///
/// - The center of the vehicle is in a lane, and every lane in which it is leads in one direction only and is opposite
///   to the vehicle's heading within 45 degrees.
/// - It drives forward at 2 m/s or more: its velocity along its heading.
///
/// The event is the longest such stretch of a vehicle; what happens before and after the scene is not known.
///
/// *What does not count*: standing; reversing, as out of a parking place; lanes that the map opens to both directions;
/// places where another lane leads along or across, as within junctions. Whoever overtakes in an oncoming lane drives
/// the wrong way, too.
///
/// **Negative**: such a stretch of 0.5 s or more that is too short.
///
/// Parameters over the event: `duration_s`, `mean_speed_mps`, `path_m` (the length of the path).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WrongWay {
    /// How long this lasts without a break, from the first to the last timestep, seconds. Default 1.5.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub min_duration_s: f64,
}

impl Default for WrongWay {
    fn default() -> Self {
        Self { min_duration_s: 1.5 }
    }
}

impl WrongWay {
    fn is_against(lanes: &SceneLanes<'_>, state: &State) -> bool {
        let is_opposite = |lane_rad: f64| angle_difference(lane_rad, state.heading_rad).abs() > PI - OPPOSITE_RAD;
        if state.velocity.dot(Vec2::from_angle(state.heading_rad)) < MIN_SPEED_MPS {
            return false;
        }
        let mut own = lanes.lanes_at(state.position).peekable();
        own.peek().is_some() && own.all(|(lane, place)| lane.lane.attributes.one_way && is_opposite(place.heading_rad))
    }

    /// The longest run of timesteps at which an agent drives against its lane.
    fn longest(lanes: &SceneLanes<'_>, track: &Track) -> Option<RangeInclusive<usize>> {
        let states = track.trajectory.valid().filter(|(_, state)| state.is_finite());
        let against = states.filter(|(_, state)| Self::is_against(lanes, state)).map(|(timestep, _)| timestep);
        let mut runs: Vec<RangeInclusive<usize>> = Vec::new();
        for timestep in against {
            match runs.last_mut() {
                Some(run) if *run.end() + 1 == timestep => *run = *run.start()..=timestep,
                _ => runs.push(timestep..=timestep),
            }
        }
        // The first among equally long runs.
        runs.into_iter().rev().max_by_key(|run| run.end() - run.start())
    }

    fn event(&self, scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<BehaviorEvent> {
        let track = &scene.tracks[agent_idx];
        let run = Self::longest(lanes, track)?;
        let duration_s = (run.end() - run.start()) as f64 * scene.dt_s;
        let lasts = |least_s: f64| duration_s >= least_s - 1e-9;
        let label = match lasts(self.min_duration_s) {
            true => EventLabel::Positive,
            false if lasts(self.min_duration_s / NEGATIVE_PART) => EventLabel::Negative,
            false => return None,
        };
        let places: Vec<Vec2> = run.clone().filter_map(|t| Some(track.trajectory.get(t)?.position)).collect();
        let path_m: f64 = places.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &[agent_idx], run)
            .with("duration_s", duration_s)
            .with("mean_speed_mps", path_m / duration_s)
            .with("path_m", path_m);
        Some(event)
    }
}

impl Behavior for WrongWay {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["mean_speed_mps", "duration_s"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.first().map_or_else(Vec::new, |agent_idx| self.drives_against(scene, *agent_idx))
    }

    /// At most one event an agent, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let considered = (0..scene.tracks.len()).filter(|idx| scene.tracks[*idx].class.is_motorized());
        considered.filter_map(|agent_idx| self.event(scene, &lanes, agent_idx)).collect()
    }
}
