//! The parameters of the careful driver of UN Regulation No. 157.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The parameters of the careful driver; defaults are the regulation's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CarefulDriverConfig {
    /// A vehicle that moves sideways by at most this only wanders in its lane, meters. Default 0.375.
    #[schemars(range(min = 0.0))]
    pub wandering_m: f64,
    /// Time to perceive that a vehicle cuts in, seconds. Default 0.4.
    #[schemars(range(min = 0.0))]
    pub perception_s: f64,
    /// A time to collision of at most this is dangerous, seconds. Default 2.
    #[schemars(range(min = 0.0))]
    pub danger_ttc_s: f64,
    /// Time from danger to braking, seconds. Default 0.75.
    #[schemars(range(min = 0.0))]
    pub delay_s: f64,
    /// Time for the deceleration to reach its maximum, seconds. Default 0.6.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub ramp_s: f64,
    /// The largest deceleration, m/s². Default 7.593, that is 0.774 g.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_deceleration_mps2: f64,
    /// Width of a lane, meters: its markings lie half of that from the path. Default 3.5.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub lane_width_m: f64,
    /// A vehicle this far beyond the marking intrudes, meters. Default 0.3.
    #[schemars(range(min = 0.0))]
    pub intrusion_m: f64,
    /// The deceleration in the bound on the time to collision at the intrusion, m/s². Default 6.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub bound_deceleration_mps2: f64,
    /// The delay in that bound, seconds. Default 0.35.
    #[schemars(range(min = 0.0))]
    pub bound_delay_s: f64,
}

impl Default for CarefulDriverConfig {
    fn default() -> Self {
        Self {
            wandering_m: 0.375,
            perception_s: 0.4,
            danger_ttc_s: 2.0,
            delay_s: 0.75,
            ramp_s: 0.6,
            max_deceleration_mps2: 7.593,
            lane_width_m: 3.5,
            intrusion_m: 0.3,
            bound_deceleration_mps2: 6.0,
            bound_delay_s: 0.35,
        }
    }
}
