//! Behaviors worth finding in traffic: does this scene contain a cut-in, and which agents take part?
//!
//! One behavior per file. A new one needs its file, an entry in the list `behaviors!`, and example scenes in
//! `tests/fixtures/behavior/<id>/`, at least one with a positive and one with a negative event.
//!
//! Rules for some behaviors alone name them, and a new one may belong there: `CUT_INS` and `FROM_BEHIND` in
//! `evaluate::judge`, `DECIDED_BY_EGO` in `simulate::event`, [`needs_cause`], the tags of other formats in
//! `export::commonroad` and `export::openlabel`, and what `pipelines/README.md` says of lanes and templates.
//!
//! [`Behavior::feasible`] predicts, from the observed past and the map, which events a pair can still reach;
//! [`Behavior::template`] is a maneuver that leads to a requested one. A cut-in is solved directly. The other behaviors
//! draw up candidates, one file each in `maneuver`; kept are those that stay on the road, within the limits of vehicles
//! and clear of others, and in which the behavior's own miner finds the event.

mod cause;
mod collision;
mod conflict;
mod cut_in;
mod cut_in_paper;
mod cut_out;
pub(crate) mod driven_path;
mod event;
mod failure_to_yield;
pub(crate) mod following;
mod hard_brake;
mod intrusion;
pub(crate) mod kept_lane;
mod lane_change;
pub(crate) mod lane_relation;
mod lane_tracker;
mod left_turn;
mod limits;
mod maneuver;
mod near_miss;
mod outcome;
mod pairs;
mod pedestrian_steps_out;
mod right_turn;
mod runs_stop_line;
mod sideways;
pub(crate) mod speed_profile;
mod subject;
pub(crate) mod swept_boxes;
mod tailgating;
mod template;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod time_to_collision;
mod turn;
mod unprotected_left_turn;
pub(crate) mod way_on;
mod wrong_way;

pub use cause::{Cause, Explanation, explanation, needs_cause};
pub use event::{BehaviorEvent, EventLabel};
pub use maneuver::Maneuver;
pub(crate) use maneuver::RELEASE_JERK_MPS3;
pub use outcome::Outcome;
pub(crate) use pedestrian_steps_out::may_walk;
pub use subject::Subject;
pub use template::Template;

pub(crate) use crate::geometry::footprint;
use crate::scene::{AgentClass, Scene};
use crate::settings;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A behavior with a definition that can be checked on any scene, recorded or generated.
pub trait Behavior: Send + Sync {
    /// Its name in configs and tables, such as `cut_in`.
    fn id(&self) -> &'static str;
    /// The roles of an event, in the order in which events list them.
    fn roles(&self) -> &'static [&'static str] {
        BehaviorEntry::of(self.id()).map_or(&[], |entry| entry.roles)
    }
    /// All events of the scene, positive and (where the behavior defines them) hard negative, in a fixed order.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent>;
    /// Whether agents of this class can take part.
    fn admits(&self, class: AgentClass) -> bool {
        class.is_motorized()
    }
    /// Whether it is found only among agents of recorded size.
    fn needs_sizes(&self) -> bool {
        false
    }
    /// All agents of an event in which `pair` has the first two roles, found from the observed past and the map alone.
    /// `None` if the behavior has a further role and no agent can take it.
    fn completed(&self, _scene: &Scene, pair: [usize; 2]) -> Option<Vec<usize>> {
        Some(pair.to_vec())
    }
    /// The outcomes that `agents`, in the order of the roles, can still reach, judged from the observed past and the
    /// map alone. Empty if they cannot show the behavior. By default the outcomes of its planned maneuvers; without
    /// templates, one outcome without parameters, which allows anything.
    fn feasible(&self, scene: &Scene, agents: &[usize]) -> Vec<Outcome> {
        match self.template_parameters() {
            [] => vec![Outcome::default()],
            _ => maneuver::outcomes(self, scene, agents),
        }
    }
    /// Whether the road users of an event that the miner found move as drivers do, so that it may be accepted. Recorded
    /// ones are not asked.
    fn is_as_driven(&self, _event: &BehaviorEvent) -> bool {
        true
    }
    /// The parameters for which its templates are solved; empty if it has no templates.
    fn template_parameters(&self) -> &'static [&'static str] {
        &[]
    }
    /// Ways in which `agents`, in the order of the roles, may drive to show the behavior, drawn up from the observed
    /// past and the map alone. Each is tried before it is used.
    fn maneuvers(&self, _scene: &Scene, _agents: &[usize]) -> Vec<Maneuver> {
        Vec::new()
    }
    /// Different maneuvers that bring `agents`, in the order of the roles, to an outcome with each `wanted` parameter
    /// in its range (from, to), ends included: the first `n`, or all if there are fewer. Uses the observed past and
    /// the map alone.
    fn templates(
        &self,
        scene: &Scene,
        agents: &[usize],
        wanted: &BTreeMap<String, [f64; 2]>,
        n: usize,
    ) -> Vec<Template> {
        maneuver::templates(self, scene, agents, wanted, n)
    }
    /// One of these maneuvers: a different one for each `variant`, cyclically. `None` if there is none.
    fn template(
        &self,
        scene: &Scene,
        agents: &[usize],
        wanted: &BTreeMap<String, [f64; 2]>,
        variant: usize,
    ) -> Option<Template> {
        let mut templates = self.templates(scene, agents, wanted, variant + 1);
        let n = templates.len();
        (n > 0).then(|| templates.swap_remove(variant % n))
    }
}

/// Lists the behaviors: each has a module with its `ID`, `ROLES` and `PARAMETERS`, and a type with its name, whose
/// fields are its options.
macro_rules! behaviors {
    ($($(#[$doc:meta])* $Behavior:ident in $module:ident {
        subject: $subject:expr, is_collision: $is_collision:literal, needs_lanes: $needs_lanes:literal
    }: $description:literal,)*) => {
        $(pub use $module::$Behavior;)*

        /// A behavior to mine, with its options: `{ kind = "cut_in", max_delay_s = 2.0 }`.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
        pub enum BehaviorConfig {
            $($(#[$doc])* $Behavior($Behavior),)*
        }

        impl BehaviorConfig {
            /// The behavior with these options.
            pub fn build(&self) -> Box<dyn Behavior> {
                match self.clone() { $(Self::$Behavior(behavior) => Box::new(behavior),)* }
            }

            /// The name of the behavior.
            pub const fn id(&self) -> &'static str {
                match self { $(Self::$Behavior(_) => $module::ID,)* }
            }
        }

        /// Every behavior.
        pub static ALL: &[BehaviorEntry] = &[$(BehaviorEntry {
            id: $module::ID,
            roles: $module::ROLES,
            parameters: $module::PARAMETERS,
            description: $description,
            subject: $subject,
            is_collision: $is_collision,
            needs_lanes: $needs_lanes,
            default_config: || BehaviorConfig::$Behavior($Behavior::default()),
        }),*];
    };
}

behaviors! {
    /// One vehicle crosses into the lane of another, shortly ahead of it.
    CutIn in cut_in { subject: Subject::Role("ego"), is_collision: false, needs_lanes: true }:
        "one vehicle (other) crosses into the lane that another (ego) keeps, less than 3 s ahead of it",
    /// One vehicle gets into the path of another, whichever of the two changes course: the paper's cut-in.
    CutInPaper in cut_in_paper {
        subject: Subject::Role("ego"), is_collision: false, needs_lanes: false
    }:
        "one vehicle (other) gets into the path of another (ego) less than 3 s before that one gets there",
    /// An agent turns left.
    LeftTurn in left_turn { subject: Subject::Role("agent"), is_collision: false, needs_lanes: false }:
        "an agent turns left by at least 60 degrees, as at an intersection",
    /// An agent turns right.
    RightTurn in right_turn { subject: Subject::Role("agent"), is_collision: false, needs_lanes: false }:
        "an agent turns right by at least 60 degrees, as at an intersection",
    /// An agent changes lanes.
    LaneChange in lane_change {
        subject: Subject::Role("agent"), is_collision: false, needs_lanes: true
    }:
        "an agent moves over to the lane beside its own and stays there for at least 1 s",
    /// An agent brakes hard.
    HardBrake in hard_brake { subject: Subject::WhoMeetsIt, is_collision: false, needs_lanes: false }:
        "an agent brakes with at least 4 m/s² over at least 0.3 s",
    /// Two road users barely avoid each other.
    NearMiss in near_miss { subject: Subject::WhoComesUpon, is_collision: false, needs_lanes: false }:
        "two road users avoid each other by braking hard within 1.5 s, by 0.5 s where they cross or by 0.2 m, without \
         touching",
    /// Two road users drive into each other.
    Collision in collision { subject: Subject::WhoComesUpon, is_collision: true, needs_lanes: false }:
        "two road users drive into each other",
    /// One vehicle drives too close behind another.
    Tailgating in tailgating {
        subject: Subject::Role("leader"), is_collision: false, needs_lanes: true
    }:
        "one vehicle (follower) drives less than 0.9 s behind another (leader) for at least 2 s, both at 8 m/s or more",
    /// The vehicle ahead leaves the lane and reveals a slow one.
    CutOut in cut_out { subject: Subject::Role("ego"), is_collision: false, needs_lanes: true }:
        "the vehicle ahead (leader) leaves the lane and reveals a slow one that the ego reaches in less than 4 s",
    /// Somebody on foot steps into the lane of a vehicle.
    PedestrianStepsOut in pedestrian_steps_out {
        subject: Subject::Role("ego"), is_collision: false, needs_lanes: true
    }:
        "somebody on foot steps from beside the road into the lane of a vehicle (ego) that is less than 3 s away",
    /// One vehicle turns left across the lane of an oncoming one, shortly ahead of it.
    UnprotectedLeftTurn in unprotected_left_turn {
        subject: Subject::Role("oncoming"), is_collision: false, needs_lanes: true
    }:
        "one vehicle (turner) turns left across the lane of an oncoming one, less than 2 s before it gets there",
    /// One vehicle takes the right of way of another.
    FailureToYield in failure_to_yield {
        subject: Subject::Role("priority"), is_collision: false, needs_lanes: true
    }:
        "one vehicle (entering) gets into the way of one that has the right of way, which brakes for it with at least \
         3.4 m/s²",
    /// A vehicle drives against the direction of its lane.
    WrongWay in wrong_way { subject: Subject::WhoMeetsIt, is_collision: false, needs_lanes: true }:
        "a vehicle drives against the direction of its lane for at least 1.5 s",
    /// A vehicle does not stop where all have to.
    RunsStopLine in runs_stop_line {
        subject: Subject::Role("agent"), is_collision: false, needs_lanes: true
    }:
        "a vehicle passes the line of an all-way stop without having been slower than 2.2 m/s before it",
}

impl BehaviorConfig {
    /// Refuses options with which nothing could be found.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)
    }

    /// The behavior with this name and default options. `None` if there is no such behavior.
    pub fn from_id(id: &str) -> Option<Self> {
        BehaviorEntry::of(id).map(|entry| (entry.default_config)())
    }
}

/// The facts about a behavior that do not depend on a scene.
#[derive(Debug, Clone, Copy)]
pub struct BehaviorEntry {
    /// Its name in configs and tables.
    pub id: &'static str,
    /// The roles of its events, in order.
    pub roles: &'static [&'static str],
    /// The names of its events' parameters; not every event has all of them.
    pub parameters: &'static [&'static str],
    /// One-line description.
    pub description: &'static str,
    /// Which vehicle its events happen to.
    pub subject: Subject,
    /// Whether its agents touch each other, which no other agents may.
    pub is_collision: bool,
    /// Whether it is defined by lanes, so that scenes without lanes have no events.
    pub needs_lanes: bool,
    /// Its default options.
    pub default_config: fn() -> BehaviorConfig,
}

impl BehaviorEntry {
    /// The behavior with this name. `None` if there is no such behavior.
    pub fn of(id: &str) -> Option<&'static Self> {
        ALL.iter().find(|entry| entry.id == id)
    }

    /// Whether the agents of the behavior of this name are meant to touch.
    pub fn is_collision(id: Option<&str>) -> bool {
        id.and_then(Self::of).is_some_and(|entry| entry.is_collision)
    }
}
