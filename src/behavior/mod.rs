//! Behaviors worth finding in traffic: does this scene hold a cut-in, and who took part?
//!
//! One behavior a file. A new one needs its file, a variant of [`BehaviorConfig`], an entry in [`ALL`], and example
//! scenes in `tests/fixtures/behavior/<id>/`, at least one with a positive and one with a negative event.

mod agent_filter;
mod collision;
mod cut_in;
mod cut_in_paper;
mod cut_out;
pub(crate) mod driven_path;
mod event;
mod feasible;
mod following;
pub(crate) mod footprint;
mod hard_brake;
mod intrusion;
mod kept_lane;
mod lane_change;
pub(crate) mod lane_relation;
mod lane_tracker;
mod left_turn;
mod near_miss;
mod outcome;
mod pairs;
mod pedestrian_steps_out;
mod right_turn;
pub(crate) mod speed_profile;
pub(crate) mod sweep;
mod tailgating;
mod template;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod time_to_collision;
mod turn;

pub use agent_filter::AgentFilter;
pub use collision::{Collision, CollisionConfig};
pub use cut_in::{CutIn, CutInConfig};
pub use cut_in_paper::{CutInPaper, CutInPaperConfig};
pub use cut_out::{CutOut, CutOutConfig};
pub use event::{BehaviorEvent, EventLabel};
pub use hard_brake::{HardBrake, HardBrakeConfig};
pub use lane_change::{LaneChange, LaneChangeConfig};
pub use left_turn::LeftTurn;
pub use near_miss::{NearMiss, NearMissConfig};
pub use outcome::Outcome;
pub use pedestrian_steps_out::{PedestrianStepsOut, PedestrianStepsOutConfig};
pub use right_turn::RightTurn;
pub use tailgating::{Tailgating, TailgatingConfig};
pub use template::Template;
pub use turn::TurnConfig;

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
    /// Whether agents of this class may be asked to show it.
    fn admits(&self, class: AgentClass) -> bool {
        class.is_motorized()
    }
    /// Whether it is found among agents whose size is recorded alone.
    fn needs_sizes(&self) -> bool {
        false
    }
    /// All who would take part in an event of which `pair` has the first two roles, told from what was observed and the map alone. `None`
    /// where nobody has another role that there is.
    fn completed(&self, _scene: &Scene, pair: [usize; 2]) -> Option<Vec<usize>> {
        Some(pair.to_vec())
    }
    /// What `agents`, in the order of the roles, could still come to, told from what was observed and the map alone; empty where they
    /// cannot show the behavior. Where nothing speaks against it, one outcome that names no parameter.
    fn feasible(&self, _scene: &Scene, _agents: &[usize]) -> Vec<Outcome> {
        vec![Outcome::default()]
    }
    /// The parameters of outcomes for which its templates are solved; none where it has no templates.
    fn template_parameters(&self) -> &'static [&'static str] {
        &[]
    }
    /// Maneuvers by which `agents`, in the order of the roles, come to an outcome whose parameters are as `wanted`, each from a least to a
    /// most, told as outcomes are: the `variant`-th easiest way, counted around. Empty where there is none.
    fn templates(
        &self,
        _scene: &Scene,
        _agents: &[usize],
        _wanted: &BTreeMap<String, [f64; 2]>,
        _variant: usize,
    ) -> Vec<Template> {
        Vec::new()
    }
}

/// A behavior to mine, with its options: `{ kind = "cut_in", max_delay_s = 2.0 }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum BehaviorConfig {
    /// One vehicle crosses into the lane of another, shortly ahead of it.
    CutIn(CutInConfig),
    /// One vehicle gets into the path of another, whichever of the two changes course: the paper's cut-in.
    CutInPaper(CutInPaperConfig),
    /// An agent turns left.
    LeftTurn(TurnConfig),
    /// An agent turns right.
    RightTurn(TurnConfig),
    /// An agent changes lanes.
    LaneChange(LaneChangeConfig),
    /// An agent brakes hard.
    HardBrake(HardBrakeConfig),
    /// Two road users barely avoid each other.
    NearMiss(NearMissConfig),
    /// Two road users drive into each other.
    Collision(CollisionConfig),
    /// One vehicle drives too close behind another.
    Tailgating(TailgatingConfig),
    /// The vehicle ahead leaves the lane and reveals a slow one.
    CutOut(CutOutConfig),
    /// Somebody on foot steps into the lane of a vehicle.
    PedestrianStepsOut(PedestrianStepsOutConfig),
}

impl BehaviorConfig {
    /// The behavior with these options.
    pub fn build(&self) -> Box<dyn Behavior> {
        match self.clone() {
            Self::CutIn(config) => Box::new(CutIn::new(config)),
            Self::CutInPaper(config) => Box::new(CutInPaper::new(config)),
            Self::LeftTurn(config) => Box::new(LeftTurn::new(config)),
            Self::RightTurn(config) => Box::new(RightTurn::new(config)),
            Self::LaneChange(config) => Box::new(LaneChange::new(config)),
            Self::HardBrake(config) => Box::new(HardBrake::new(config)),
            Self::NearMiss(config) => Box::new(NearMiss::new(config)),
            Self::Collision(config) => Box::new(Collision::new(config)),
            Self::Tailgating(config) => Box::new(Tailgating::new(config)),
            Self::CutOut(config) => Box::new(CutOut::new(config)),
            Self::PedestrianStepsOut(config) => Box::new(PedestrianStepsOut::new(config)),
        }
    }

    /// Refuses options by which nothing could be found, or what is found would not be what the behavior says.
    ///
    /// # Errors
    /// Names the option.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        match self {
            Self::HardBrake(config) => {
                let least = ("min_deceleration_mps2", config.min_deceleration_mps2);
                settings::ascending(("negative_deceleration_mps2", config.negative_deceleration_mps2), least)?;
                settings::ascending(least, ("max_deceleration_mps2", config.max_deceleration_mps2))
            }
            Self::LeftTurn(config) | Self::RightTurn(config) => {
                let negative = ("negative_heading_change_rad", config.negative_heading_change_rad);
                settings::ascending(negative, ("min_heading_change_rad", config.min_heading_change_rad))?;
                settings::ascending(("min_radius_m", config.min_radius_m), ("max_radius_m", config.max_radius_m))
            }
            Self::Tailgating(config) => {
                let least = ("max_headway_s", config.max_headway_s);
                settings::ascending(least, ("negative_headway_s", config.negative_headway_s))
            }
            Self::PedestrianStepsOut(config) => {
                let most = ("negative_time_to_arrival_s", config.negative_time_to_arrival_s);
                settings::ascending(("max_time_to_arrival_s", config.max_time_to_arrival_s), most)
            }
            Self::CutIn(_)
            | Self::CutInPaper(_)
            | Self::LaneChange(_)
            | Self::NearMiss(_)
            | Self::Collision(_)
            | Self::CutOut(_) => Ok(()),
        }
    }

    /// The name of the behavior.
    pub const fn id(&self) -> &'static str {
        match self {
            Self::CutIn(_) => cut_in::ID,
            Self::CutInPaper(_) => cut_in_paper::ID,
            Self::LeftTurn(_) => left_turn::ID,
            Self::RightTurn(_) => right_turn::ID,
            Self::LaneChange(_) => lane_change::ID,
            Self::HardBrake(_) => hard_brake::ID,
            Self::NearMiss(_) => near_miss::ID,
            Self::Collision(_) => collision::ID,
            Self::Tailgating(_) => tailgating::ID,
            Self::CutOut(_) => cut_out::ID,
            Self::PedestrianStepsOut(_) => pedestrian_steps_out::ID,
        }
    }

    /// The behavior of this name with default options. `None` when there is no such behavior.
    pub fn from_id(id: &str) -> Option<Self> {
        BehaviorEntry::of(id).map(|entry| (entry.default_config)())
    }
}

/// What there is to say of a behavior without a scene.
#[derive(Debug, Clone, Copy)]
pub struct BehaviorEntry {
    /// Its name in configs and tables.
    pub id: &'static str,
    /// The roles of its events, in order.
    pub roles: &'static [&'static str],
    /// The names of its events' parameters; not every event has all of them.
    pub parameters: &'static [&'static str],
    /// What it is, in a line.
    pub description: &'static str,
    /// Whether those who show it touch, which nobody else may.
    pub is_collision: bool,
    /// Whether it is found along lanes, and so not at all in scenes without any.
    pub needs_lanes: bool,
    /// Its default options.
    pub default_config: fn() -> BehaviorConfig,
}

impl BehaviorEntry {
    /// The behavior of this name. `None` when there is no such behavior.
    pub fn of(id: &str) -> Option<&'static Self> {
        ALL.iter().find(|entry| entry.id == id)
    }

    /// Whether those of whom the behavior of this name is asked are to touch.
    pub fn is_collision(id: Option<&str>) -> bool {
        id.and_then(Self::of).is_some_and(|entry| entry.is_collision)
    }
}

/// Every behavior.
pub static ALL: &[BehaviorEntry] = &[
    BehaviorEntry {
        id: cut_in::ID,
        roles: cut_in::ROLES,
        parameters: cut_in::PARAMETERS,
        description: "one vehicle (other) crosses into the lane that another (ego) keeps, less than 3 s ahead of it",
        is_collision: false,
        needs_lanes: true,
        default_config: || BehaviorConfig::CutIn(CutInConfig::default()),
    },
    BehaviorEntry {
        id: cut_in_paper::ID,
        roles: cut_in_paper::ROLES,
        parameters: cut_in_paper::PARAMETERS,
        description: "one vehicle (other) gets into the path of another (ego) less than 3 s before that one gets there",
        is_collision: false,
        needs_lanes: false,
        default_config: || BehaviorConfig::CutInPaper(CutInPaperConfig::default()),
    },
    BehaviorEntry {
        id: left_turn::ID,
        roles: turn::ROLES,
        parameters: turn::PARAMETERS,
        description: "an agent turns left by at least 60 degrees, as at an intersection",
        is_collision: false,
        needs_lanes: false,
        default_config: || BehaviorConfig::LeftTurn(TurnConfig::default()),
    },
    BehaviorEntry {
        id: right_turn::ID,
        roles: turn::ROLES,
        parameters: turn::PARAMETERS,
        description: "an agent turns right by at least 60 degrees, as at an intersection",
        is_collision: false,
        needs_lanes: false,
        default_config: || BehaviorConfig::RightTurn(TurnConfig::default()),
    },
    BehaviorEntry {
        id: lane_change::ID,
        roles: lane_change::ROLES,
        parameters: lane_change::PARAMETERS,
        description: "an agent moves over to the lane beside its own and stays there for at least 1 s",
        is_collision: false,
        needs_lanes: true,
        default_config: || BehaviorConfig::LaneChange(LaneChangeConfig::default()),
    },
    BehaviorEntry {
        id: hard_brake::ID,
        roles: hard_brake::ROLES,
        parameters: hard_brake::PARAMETERS,
        description: "an agent brakes with at least 4 m/s² over at least 0.3 s",
        is_collision: false,
        needs_lanes: false,
        default_config: || BehaviorConfig::HardBrake(HardBrakeConfig::default()),
    },
    BehaviorEntry {
        id: near_miss::ID,
        roles: near_miss::ROLES,
        parameters: near_miss::PARAMETERS,
        description: "two road users avoid each other by braking hard within 1.5 s, by 0.5 s where they cross or by 0.2 m, without touching",
        is_collision: false,
        needs_lanes: false,
        default_config: || BehaviorConfig::NearMiss(NearMissConfig::default()),
    },
    BehaviorEntry {
        id: collision::ID,
        roles: collision::ROLES,
        parameters: collision::PARAMETERS,
        description: "two road users drive into each other",
        is_collision: true,
        needs_lanes: false,
        default_config: || BehaviorConfig::Collision(CollisionConfig::default()),
    },
    BehaviorEntry {
        id: tailgating::ID,
        roles: tailgating::ROLES,
        parameters: tailgating::PARAMETERS,
        description: "one vehicle (follower) drives less than 0.9 s behind another (leader) for at least 2 s, both at 8 m/s or more",
        is_collision: false,
        needs_lanes: true,
        default_config: || BehaviorConfig::Tailgating(TailgatingConfig::default()),
    },
    BehaviorEntry {
        id: cut_out::ID,
        roles: cut_out::ROLES,
        parameters: cut_out::PARAMETERS,
        description: "the vehicle ahead (leader) leaves the lane and reveals a slow one that the ego reaches in less than 4 s",
        is_collision: false,
        needs_lanes: true,
        default_config: || BehaviorConfig::CutOut(CutOutConfig::default()),
    },
    BehaviorEntry {
        id: pedestrian_steps_out::ID,
        roles: pedestrian_steps_out::ROLES,
        parameters: pedestrian_steps_out::PARAMETERS,
        description: "somebody on foot steps from beside the road into the lane of a vehicle (ego) that is less than 3 s away",
        is_collision: false,
        needs_lanes: true,
        default_config: || BehaviorConfig::PedestrianStepsOut(PedestrianStepsOutConfig::default()),
    },
];
