//! Pedestrian steps out: does a pedestrian enter the lane of a vehicle, shortly ahead of it?

use super::following::Follower;
use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::Vec2;
use crate::scene::{AgentClass, Scene, State};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "pedestrian_steps_out";
/// The roles: the driver, and the pedestrian who steps out.
pub(super) const ROLES: &[&str] = &["ego", "pedestrian"];
/// Names of the parameters of its events, defined at [`PedestrianStepsOut`].
pub(super) const PARAMETERS: &[&str] = &["time_to_arrival_s", "gap_m", "ego_speed_mps", "pedestrian_speed_mps", "side"];

/// An agent that is ever faster than this is a cyclist, m/s: some recordings do not separate pedestrians from cyclists.
pub(super) const MAX_PEDESTRIAN_MPS: f64 = 3.0;
/// Whether an agent in this state may be a pedestrian.
pub(crate) fn may_walk(class: AgentClass, state: &State) -> bool {
    let is_class = matches!(class, AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist);
    is_class && state.speed_mps() <= MAX_PEDESTRIAN_MPS
}

/// Times to arrival that are too long by less than this are a hard negative, seconds.
const NEGATIVE_MORE_S: f64 = 2.0;

/// The vehicle drives at least this fast then, m/s: a slower one is waiting.
const MIN_SPEED_MPS: f64 = 3.0;

/// A pedestrian (`pedestrian`) steps from beside the road into the lane that a vehicle (`ego`) keeps, shortly ahead of
/// it.
///
/// The lane of the ego is the one it is in at present, with those that lead to it and follow on. The future is every
/// timestep after the present.
///
/// **Positive**: all of
///
/// - At present the pedestrian's center is in no lane of the map: it stands or walks beside the road.
/// - In the future it enters the lane of the ego: the *step*, the first timestep at which its center is between the
///   sides of the lane.
/// - At the step the ego is in the lane, drives at least 3 m/s, and its front would reach the pedestrian at this speed
///   in less than 3 s (time to arrival: gap per speed).
/// - The pedestrian is never faster than 3 m/s: recordings in which pedestrians and cyclists are one class hold both.
///
/// The event *starts* when its box begins to reach over the side of the lane, and is *complete* at the step. It is the
/// pedestrian conflict of NHTSA's pre-crash typology (Najm et al. 2007, "pedestrian crash without prior vehicle
/// maneuver"); Euro NCAP's tests of crossing pedestrians begin at 4 s and have them walk at 5 km/h.
///
/// *What does not count*: pedestrians who cross another lane first and are therefore visible on the road; vehicles that
/// wait or creep; pedestrians who step out beside or behind the vehicle; egos that are in no lane at present.
///
/// **Negative**: the same with a time to arrival below 5 s, or with a slower vehicle.
///
/// Parameters, all at the step: `time_to_arrival_s` (absent where the ego stands), `gap_m` (from the ego's front to the
/// pedestrian, along the lane), `ego_speed_mps`, `pedestrian_speed_mps`, `side` (from which it comes: +1 left, -1
/// right).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PedestrianStepsOut {
    /// The vehicle is this far away at most at its speed when the pedestrian steps out, seconds. Default 3.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub max_time_to_arrival_s: f64,
}

impl Default for PedestrianStepsOut {
    fn default() -> Self {
        Self { max_time_to_arrival_s: 3.0 }
    }
}

/// The relation of a vehicle and a pedestrian at a timestep.
#[derive(Debug, Clone, Copy)]
struct Step {
    timestep: usize,
    side: f64,
    gap_m: f64,
    ego_mps: f64,
}

impl PedestrianStepsOut {
    /// Whether the agent is on foot, judged by its timesteps before `end`, and beside the road at present.
    pub(super) fn is_beside_road(&self, scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize, end: usize) -> bool {
        let track = &scene.tracks[agent_idx];
        let mut states = track.trajectory.valid().filter(|(t, state)| *t < end && state.is_finite());
        is_on_foot(track.class)
            && states.all(|(_, state)| state.speed_mps() <= MAX_PEDESTRIAN_MPS)
            && finite(scene, agent_idx, scene.current_timestep())
                .is_some_and(|state| lanes.lanes_at(state.position).next().is_none())
    }

    fn step(&self, scene: &Scene, ego: &Follower<'_>, [ego_idx, pedestrian_idx]: [usize; 2]) -> Option<Step> {
        let position = |t: usize| finite(scene, pedestrian_idx, t).map(|state| state.position);
        let beyond_m = |t: usize, side: f64| ego.lane.beyond_m(position(t)?, side);
        let is_in = |t: &usize| [1.0, -1.0].into_iter().all(|side| beyond_m(*t, side).is_some_and(|m| m <= 0.0));
        let timestep = (scene.n_history..scene.n_timesteps).find(is_in)?;
        let own = ego.state_in_lane(ego_idx, timestep)?;
        let (place, theirs) = (ego.lane.project(own.position)?, ego.lane.project(position(timestep)?)?);
        let half_m = |idx: usize| scene.tracks[idx].extent_or_nominal().length_m / 2.0;
        let gap_m = theirs.station_m - place.station_m - half_m(ego_idx) - half_m(pedestrian_idx);
        let came_from = ego.lane.project(position(scene.current_timestep())?)?.offset_m;
        let side = if came_from < 0.0 { -1.0 } else { 1.0 };
        let ego_mps = own.velocity.dot(Vec2::from_angle(place.heading_rad));
        (gap_m > 0.0).then_some(Step { timestep, side, gap_m, ego_mps })
    }

    fn event(&self, scene: &Scene, ego: &Follower<'_>, pair: [usize; 2]) -> Option<BehaviorEvent> {
        let step = self.step(scene, ego, pair)?;
        let arrives_within = |time_s: f64| step.gap_m < time_s * step.ego_mps;
        let label = match step.ego_mps >= MIN_SPEED_MPS && arrives_within(self.max_time_to_arrival_s) {
            true => EventLabel::Positive,
            false if arrives_within(self.max_time_to_arrival_s + NEGATIVE_MORE_S) => EventLabel::Negative,
            false => return None,
        };
        let half_width_m = scene.tracks[pair[1]].extent_or_nominal().width_m / 2.0;
        let reaches_over = |t: &usize| {
            let state = finite(scene, pair[1], *t);
            state.and_then(|state| ego.lane.beyond_m(state.position, step.side)).is_some_and(|m| m < half_width_m)
        };
        let start = (0..=step.timestep).rev().take_while(reaches_over).last().unwrap_or(step.timestep);
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &pair, start..=step.timestep)
            .with("time_to_arrival_s", (step.ego_mps > 0.1).then(|| step.gap_m / step.ego_mps))
            .with("gap_m", step.gap_m)
            .with("ego_speed_mps", step.ego_mps)
            .with("pedestrian_speed_mps", finite(scene, pair[1], step.timestep).map(State::speed_mps))
            .with("side", step.side);
        Some(event)
    }
}

/// Whether agents of this class may be on foot.
const fn is_on_foot(class: AgentClass) -> bool {
    matches!(class, AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist)
}

fn finite(scene: &Scene, agent_idx: usize, timestep: usize) -> Option<&State> {
    scene.state(agent_idx, timestep).filter(|state| state.is_finite())
}

impl Behavior for PedestrianStepsOut {
    fn id(&self) -> &'static str {
        ID
    }

    fn admits(&self, class: AgentClass) -> bool {
        class.is_motorized() || is_on_foot(class)
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["time_to_arrival_s", "gap_m", "ego_speed_mps", "side"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |agents| self.steps_across(scene, agents))
    }

    /// At most one event a pair, in the order of the tracks of vehicles, then of pedestrians.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let agents = 0..scene.tracks.len();
        let is_on_road = |idx: usize, t: usize| {
            finite(scene, idx, t).is_some_and(|state| lanes.lanes_at(state.position).next().is_some())
        };
        let steps_out = |idx: &usize| {
            self.is_beside_road(scene, &lanes, *idx, scene.n_timesteps)
                && (scene.n_history..scene.n_timesteps).any(|t| is_on_road(*idx, t))
        };
        let pedestrians: Vec<usize> = agents.clone().filter(steps_out).collect();
        if pedestrians.is_empty() {
            return Vec::new();
        }
        let egos = agents.filter(|idx| scene.tracks[*idx].class.is_motorized());
        let with_lane = |idx: usize| Some((idx, Follower::of(scene, &lanes, idx)?));
        egos.filter_map(with_lane)
            .flat_map(|(ego_idx, ego)| {
                let of_ego = |pedestrian_idx: &usize| self.event(scene, &ego, [ego_idx, *pedestrian_idx]);
                pedestrians.iter().filter_map(of_ego).collect::<Vec<_>>()
            })
            .collect()
    }
}
