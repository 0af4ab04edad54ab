//! Failure to yield: does one vehicle take the right of way of another?

use super::conflict::{Conflict, Course};
use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::Vec2;
use crate::scene::{LaneDuty, Scene, State};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "failure_to_yield";
/// The vehicle that enters without the right of way, and the one that has it.
pub(super) const ROLES: &[&str] = &["entering", "priority"];
/// Names of the parameters of its events, defined at [`FailureToYield`].
pub(super) const PARAMETERS: &[&str] =
    &["pet_s", "time_to_arrival_s", "entering_speed_mps", "priority_speed_mps", "max_deceleration_mps2"];

/// A rule applies to conflicts at most this far from the end of the lanes that it names, meters.
const RULE_REACH_M: f64 = 40.0;

/// Without braking, a post-encroachment time that is too long by less than this is a hard negative, seconds.
const NEGATIVE_MORE_S: f64 = 1.5;

/// One vehicle (`entering`) gets into the way of another that has the right of way (`priority`), shortly ahead of it.
///
/// The lanes are those that the two turn out to keep: the one that each is in at present, with those that lead to it
/// and follow on. Who has the right of way is what the map says: in one rule (Lanelet2's regulatory element
/// `right_of_way`), the entering vehicle comes along a lane that yields, the other along one that has the right of way,
/// and both lanes end within 40 m of where the first enters. A map without such rules has no events.
///
/// The *conflict zone* is the ground that the box of the entering vehicle covers while it overlaps the strip that the
/// other covers on its way, at an angle of at least 30 degrees: until it has crossed this strip, or turned into it.
///
/// **Positive**: all of
///
/// - The entering vehicle enters the conflict zone before the other, which then drives at 3 m/s or more and would get
///   there in less than 4 s at that speed. The boxes never touch.
/// - The other has to act: at the speed of a second before, the *post-encroachment time* would be below 1 s. That is
///   the time from when the entering vehicle has left the conflict zone until the other enters it; negative if that is
///   earlier. If the other does not get there while it is tracked, the time is predicted from its place and speed when
///   the first has left.
/// - From that second on it does act, as for a hazard: it brakes with 3.4 m/s² or more (over half a second). Nine of
///   ten drivers who have to stop for an unexpected object brake at least as hard (AASHTO's Green Book, on stopping
///   sight distances, after NCHRP report 400).
///
/// The event *starts* when the entering vehicle enters the conflict zone and is *complete* when the other does, or, if
/// that is not recorded, when the entering vehicle has left.
///
/// *What does not count*: two that both yield, or both have the right of way; all-way stops and signals; conflicts that
/// the scene shows only in part.
///
/// **Negative**: the same where nobody has to act or does, with a post-encroachment time of up to 2.5 s.
///
/// Parameters: `pet_s` (absent if the other stops before the conflict zone); when the first enters, `time_to_arrival_s`
/// (of the other at the conflict zone, if it kept its speed), `entering_speed_mps` and `priority_speed_mps`;
/// `max_deceleration_mps2` (the hardest braking of the other from a second before on; 0 if it does not brake).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FailureToYield {
    /// A post-encroachment time below this is short, seconds. Default 1. Who would come later without braking does not
    /// have to brake.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_pet_s: f64,
    /// Who has the right of way brakes if it does so with at least this, m/s². Default 3.4: less is easing
    /// off, as for anybody ahead.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub min_deceleration_mps2: f64,
    /// It brakes for the one that enters if it would get there in less than this, seconds. Default 4.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub max_time_to_arrival_s: f64,
    /// It drives at least this fast when the other enters, m/s. Default 3: who is slower lets the other go.
    #[schemars(range(min = 0.0))]
    pub min_speed_mps: f64,
}

impl Default for FailureToYield {
    fn default() -> Self {
        Self { max_pet_s: 1.0, min_deceleration_mps2: 3.4, max_time_to_arrival_s: 4.0, min_speed_mps: 3.0 }
    }
}

/// An agent that may take part, with the places where its lanes end at which rules apply to it.
struct Agent<'a> {
    agent_idx: usize,
    course: Course<'a>,
    duties: Vec<(String, LaneDuty, Vec2)>,
}

impl<'a> Agent<'a> {
    fn of(scene: &'a Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let course = Course::of(scene, lanes, agent_idx)?;
        let own = course.lane.ids().iter().filter_map(|id| lanes.get(*id)).map(|lane| lane.lane);
        let duties = own.flat_map(|lane| {
            let end = lane.centerline.0.last().copied();
            lane.attributes.duties().filter_map(move |(rule, duty)| Some((rule.to_owned(), duty, end?)))
        });
        Some(Self { agent_idx, duties: duties.collect(), course })
    }

    /// The rules at the ends of its lanes near `place` that give it this duty.
    fn rules(&self, wanted: LaneDuty, place: Vec2) -> impl Iterator<Item = &str> {
        let near =
            self.duties.iter().filter(move |(_, duty, end)| *duty == wanted && end.distance(place) < RULE_REACH_M);
        near.map(|(rule, ..)| rule.as_str())
    }

    /// Whether it yields to the other at `place`.
    fn yields_to(&self, other: &Self, place: Vec2) -> bool {
        let mut rules = self.rules(LaneDuty::Yields, place);
        rules.any(|rule| other.rules(LaneDuty::HasRightOfWay, place).any(|theirs| theirs == rule))
    }
}

impl FailureToYield {
    fn event(&self, scene: &Scene, entering: &Agent<'_>, priority: &Agent<'_>) -> Option<BehaviorEvent> {
        let negative_pet_s = self.max_pet_s + NEGATIVE_MORE_S;
        let within_s = negative_pet_s.max(self.max_time_to_arrival_s);
        let conflict = Conflict::between(&entering.course, &priority.course, within_s)?;
        let own = entering.course.state(conflict.enters).filter(|own| entering.yields_to(priority, own.position))?;
        let speed_mps = priority.course.state(conflict.enters).map(State::speed_mps);
        let speed_mps = speed_mps.filter(|mps| *mps >= self.min_speed_mps)?;
        let arrival_s = conflict.arrival_s(&priority.course, conflict.enters);
        let arrival_s = arrival_s.filter(|arrival_s| *arrival_s < self.max_time_to_arrival_s)?;
        let pet_s = conflict.pet_s(&priority.course, scene.dt_s);
        let deceleration_mps2 = priority.course.strongest_deceleration_mps2(scene, conflict.foreseen(scene.dt_s));
        let is_below = |limit_s: f64| pet_s.is_some_and(|pet_s| pet_s < limit_s);
        let has_to_act =
            conflict.pet_at_kept_speed_s(&priority.course, scene.dt_s).is_some_and(|pet_s| pet_s < self.max_pet_s);
        let acts = deceleration_mps2.is_some_and(|mps2| mps2 >= self.min_deceleration_mps2);
        let label = match has_to_act && acts {
            true => EventLabel::Positive,
            false if is_below(negative_pet_s) => EventLabel::Negative,
            false => return None,
        };
        let timesteps = conflict.enters..=conflict.last_timestep();
        let agents = [entering.agent_idx, priority.agent_idx];
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &agents, timesteps)
            .with("pet_s", pet_s)
            .with("time_to_arrival_s", arrival_s)
            .with("entering_speed_mps", own.speed_mps())
            .with("priority_speed_mps", speed_mps)
            .with("max_deceleration_mps2", deceleration_mps2);
        Some(event)
    }
}

impl Behavior for FailureToYield {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["pet_s", "priority_speed_mps"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |agents| self.enters_ahead(scene, agents))
    }

    /// At most one event for each ordered pair, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let admitted = (0..scene.tracks.len()).filter(|idx| scene.tracks[*idx].class.is_motorized());
        let agents: Vec<Agent<'_>> = admitted.filter_map(|agent_idx| Agent::of(scene, &lanes, agent_idx)).collect();
        let with = |wanted: LaneDuty| {
            agents.iter().filter(move |agent| agent.duties.iter().any(|(_, duty, _)| *duty == wanted))
        };
        let pairs = with(LaneDuty::Yields).flat_map(|one| with(LaneDuty::HasRightOfWay).map(move |other| (one, other)));
        let pairs = pairs.filter(|(one, other)| one.agent_idx != other.agent_idx);
        pairs.filter_map(|(entering, priority)| self.event(scene, entering, priority)).collect()
    }
}
