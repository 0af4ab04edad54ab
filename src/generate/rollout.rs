//! How scenarios of a sweep go on in a closed loop.

use crate::settings::{Issue, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A closed loop: a sample is driven for `replan_s`; from then on the futures of everybody are sampled anew every
/// `replan_s`, from the last second that was driven, as the sweep samples but without its guidance. Other traffic
/// arrives and leaves, as in `djinn drive`. Until the requested event has happened, its other agents follow the sample,
/// faster or slower where the ego would undo it. Samples without the requested event stay as they are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SweepRollout {
    /// Its length after the present, seconds. It ends earlier where the ego hits somebody or leaves the road after the
    /// end of the sample.
    #[schemars(range(max = 600.0), extend("exclusiveMinimum" = 0))]
    pub horizon_s: f64,
    /// How long each plan is driven, seconds.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub replan_s: f64,
    /// The driver of the vehicle to which the event happens, or of the ego of the scene.
    pub ego: NamedDriver,
}

impl Default for SweepRollout {
    fn default() -> Self {
        Self { horizon_s: 8.0, replan_s: 0.5, ego: NamedDriver::Model }
    }
}

impl SweepRollout {
    /// Rejects what cannot be driven, whatever the model.
    pub(super) fn validate(&self) -> Result {
        match self.replan_s <= self.horizon_s {
            true => Ok(()),
            false => Err(Issue::new(
                "replan_s",
                format_args!("is {}, expected at most horizon_s, which is {}", self.replan_s, self.horizon_s),
            )),
        }
    }

    /// How often futures are sampled anew.
    pub(super) fn n_replans(&self) -> u64 {
        (self.horizon_s / self.replan_s - 1e-6).floor() as u64
    }
}

/// A driver that needs no planner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NamedDriver {
    /// The model, as for everybody else.
    #[default]
    Model,
    /// The states of the scenario; after its end, straight on along the lane at the last speed.
    Log,
    /// The path of the scenario at the present speed.
    ConstantVelocity,
    /// The path of the scenario by the intelligent driver model.
    Idm,
    /// The careful driver of UN Regulation No. 157 on the path of the scenario.
    Careful,
}

impl NamedDriver {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Model, Self::Log, Self::ConstantVelocity, Self::Idm, Self::Careful];

    /// The name in configurations, on the command line and in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Model => "model",
            Self::Log => "log",
            Self::ConstantVelocity => "constant_velocity",
            Self::Idm => "idm",
            Self::Careful => "careful",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_counted_after_the_first() {
        let n =
            |horizon_s: f64, replan_s: f64| SweepRollout { horizon_s, replan_s, ..SweepRollout::default() }.n_replans();
        assert_eq!([n(8.0, 0.5), n(3.0, 3.0), n(1.2, 0.5), n(0.9, 0.3)], [15, 0, 2, 2]);
        assert!(SweepRollout { replan_s: 9.0, ..SweepRollout::default() }.validate().is_err());
    }
}
