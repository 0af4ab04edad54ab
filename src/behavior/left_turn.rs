//! Left turn: does an agent turn left by a large angle in little room?

pub(super) use super::turn::{PARAMETERS, ROLES};

use super::maneuver::{Maneuver, turn_maneuvers};
use super::turn::{TurnSide, turns};
use super::{Behavior, BehaviorEvent};
use crate::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "left_turn";

/// One agent (`agent`) turns left, as at an intersection.
///
/// **Positive**: from its first to its last tracked timestep the agent's heading changes by at least 60 degrees to the
/// left, on a mean radius of at most 50 m.
///
/// - The event *starts* when the heading has changed by 10 % of that for good, and is *complete* when it has changed
///   by 90 % for the first time.
/// - *What does not count*: changes that the agent undoes within the scene, since the net change decides; headings that
///   jump while the agent creeps or stands (less than 3 m of path between start and end) or that no vehicle can steer
///   (a mean radius below 3 m). Agents that enter, circle or leave a roundabout do not count either: lanes that lead
///   back to themselves within 250 m, the lanes beside them, and those that lead there or come from there.
///
/// **Negative**: a net change between 30 and 60 degrees to the left, or a larger one on a wider radius, as where
/// the road itself bends.
///
/// Parameters: `heading_change_rad` (over all; positive to the left), and between start and end `radius_m`
/// (path per change of heading), `path_m`, `duration_s`, `mean_speed_mps` and `lateral_acceleration_mps2` (mean speed
/// squared per radius).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeftTurn {}

impl Behavior for LeftTurn {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["mean_speed_mps"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.first().map_or_else(Vec::new, |agent_idx| turn_maneuvers(scene, *agent_idx))
    }

    /// At most one event an agent, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        turns(ID, TurnSide::Left, scene)
    }
}
