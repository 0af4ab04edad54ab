//! The options of near misses.

use crate::behavior::AgentFilter;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Options of [`super::NearMiss`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NearMissConfig {
    /// Road users that take part. Default `road_users`: includes pedestrians, excludes static objects.
    pub agents: AgentFilter,
    /// Whether only road users of recorded size take part. Default true. If false, the others take part with half their
    /// nominal length and width; their tracks usually cannot separate near misses from noise.
    pub recorded_sizes: bool,
    /// Boxes that pass each other closer than this are a near miss, meters. Default 0.2, at which mirrors touch; in
    /// dense traffic 1 m is usual. Applies only to road users of recorded size.
    #[schemars(range(min = 0.0))]
    pub max_distance_m: f64,
    /// Smallest difference of velocities of two that pass this closely, m/s. Default 8: less is overtaking in the next
    /// lane.
    #[schemars(range(min = 0.0))]
    pub min_passing_mps: f64,
    /// Boxes on a collision course with less time to collision than this are a near miss, seconds. Default 1.5.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_ttc_s: f64,
    /// Smallest deceleration that avoids the collision on that course, m/s². Default 3.4: less is ordinary stopping
    /// behind each other.
    #[schemars(range(min = 0.0))]
    pub min_drac_mps2: f64,
    /// Crossing a place less than this after the other, on a different course, is a near miss, seconds. Default 0.5:
    /// turning off a second behind an oncoming vehicle is usual.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_pet_s: f64,
    /// How far boxes must overlap on a collision course or in a crossing, meters; at most half their size. Default 0.5:
    /// less is grazing, for which courses are not known precisely enough.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub min_overlap_m: f64,
    /// Boxes that come closer than this without a near miss are a hard negative, meters. Default 2.
    #[schemars(range(min = 0.0))]
    pub negative_distance_m: f64,
    /// Boxes on a collision course with less time to collision than this, without a near miss, are a hard negative,
    /// seconds. Default 3.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub negative_ttc_s: f64,
    /// One of the two must move at least this fast, m/s. Default 1.
    #[schemars(range(min = 0.0))]
    pub min_speed_mps: f64,
}

impl Default for NearMissConfig {
    fn default() -> Self {
        Self {
            agents: AgentFilter::RoadUsers,
            recorded_sizes: true,
            max_distance_m: 0.2,
            min_passing_mps: 8.0,
            max_ttc_s: 1.5,
            min_drac_mps2: 3.4,
            max_pet_s: 0.5,
            min_overlap_m: 0.5,
            negative_distance_m: 2.0,
            negative_ttc_s: 3.0,
            min_speed_mps: 1.0,
        }
    }
}

impl NearMissConfig {
    /// Whether a collision in `time_s` is imminent, and hard to avoid at this relative speed.
    pub(in crate::behavior) fn is_urgent(&self, time_s: f64, relative_mps: f64) -> bool {
        time_s < self.max_ttc_s && relative_mps >= 2.0 * time_s * self.min_drac_mps2
    }
}
