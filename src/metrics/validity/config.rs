//! The limits of a valid scenario.

use super::Check;
use crate::scene::Dataset;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The limits of a valid scenario. Exceeding a limit is a violation; checks can be skipped by name.
///
/// The defaults are limits of what is possible, not of what is comfortable: many scenarios are emergencies. They are
/// wider than nuPlan's bounds of comfort (acceleration -4.05 to 2.40 m/s², lateral 4.89 m/s², yaw rate 0.95 rad/s, jerk
/// 8.37 m/s³).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ValidityConfig {
    /// Checks to skip.
    pub skip: Vec<Check>,
    /// The datasets whose positions are good enough for checks of motion: acceleration, deceleration, lateral
    /// acceleration, jerk, yaw rate, curvature, heading and those of the start. Default `interaction` and `argoverse2`:
    /// Argoverse 1 has positions of a tracker, unfiltered and at uneven times, so that no recorded scene would pass.
    pub motion_of: Vec<Dataset>,
    /// Largest acceleration along the motion, m/s². Default 5: sports cars.
    #[schemars(range(min = 0.0))]
    pub max_acceleration_mps2: f64,
    /// Largest deceleration along the motion, m/s². Default 9: full braking on a dry road.
    #[schemars(range(min = 0.0))]
    pub max_deceleration_mps2: f64,
    /// Largest acceleration across the motion, m/s². Default 9: the grip of tires.
    #[schemars(range(min = 0.0))]
    pub max_lateral_acceleration_mps2: f64,
    /// Largest jerk in any direction, m/s³. Default 25: full braking within a third of a second.
    #[schemars(range(min = 0.0))]
    pub max_jerk_mps3: f64,
    /// Largest yaw rate, rad/s. Default 1.2.
    #[schemars(range(min = 0.0))]
    pub max_yaw_rate_radps: f64,
    /// Largest curvature of a path, 1/m: the yaw rate may be this times the speed. Default 0.3, a circle of 3.3 m.
    #[schemars(range(min = 0.0))]
    pub max_curvature_per_m: f64,
    /// Largest angle between heading and motion for vehicles faster than 2 m/s, radians, beyond what their turning
    /// explains and the largest one among the given states of the vehicle. Default 0.07, 4 degrees:
    /// of the tracks of simulated recordings 99 % stay below 3.4 degrees.
    #[schemars(range(min = 0.0))]
    pub max_slip_rad: f64,
    /// Where given and generated states meet: largest distance of the next state from the extrapolated motion, meters.
    /// Default 0.3.
    #[schemars(range(min = 0.0))]
    pub max_start_offset_m: f64,
    /// Where given and generated states meet: largest turn from one timestep to the next, radians. Default 0.2.
    #[schemars(range(min = 0.0))]
    pub max_start_turn_rad: f64,
    /// How far the center of a vehicle may be outside the lanes (for lanes without boundaries: 1.9 m on either side of
    /// their center line), meters. Default 0.3.
    #[schemars(range(min = 0.0))]
    pub offroad_slack_m: f64,
    /// If more than this share of the states of recorded vehicles lies off the road, or more than this share of the
    /// recorded scenes has a departure from it, the map of the place lacks parts of the road. Departures are then
    /// judged by its lanes and the area where recorded vehicles drive; not at all where that of one half of the
    /// recordings does not hold the other half as well as that. Every table says so. Default 0.03; 1 to judge them by
    /// any map.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_recorded_offroad: f64,
    /// Whether requested agents may collide with each other, whatever the requested behavior; if it is `collision`,
    /// they always may. Default false.
    pub asked_may_collide: bool,
}

impl Default for ValidityConfig {
    fn default() -> Self {
        Self {
            skip: Vec::new(),
            motion_of: Dataset::ALL.into_iter().filter(|dataset| dataset.facts().has_clean_motion).collect(),
            max_acceleration_mps2: 5.0,
            max_deceleration_mps2: 9.0,
            max_lateral_acceleration_mps2: 9.0,
            max_jerk_mps3: 25.0,
            max_yaw_rate_radps: 1.2,
            max_curvature_per_m: 0.3,
            max_slip_rad: 0.07,
            max_start_offset_m: 0.3,
            max_start_turn_rad: 0.2,
            offroad_slack_m: 0.3,
            max_recorded_offroad: 0.03,
            asked_may_collide: false,
        }
    }
}

impl ValidityConfig {
    /// Whether motion is checked in scenes of this dataset.
    pub fn checks_motion_of(&self, dataset: Dataset) -> bool {
        self.motion_of.contains(&dataset)
    }
}
