//! How scenarios of a sweep go on in a closed loop.

use crate::scene::Scene;
use crate::settings::{Issue, Result, named};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The longest maneuver of a template, seconds: most lane changes take less.
const MANEUVER_S: f64 = 5.0;

/// A closed loop: a sample is driven for `replan_s`; from then on the futures of everybody are sampled anew every
/// `replan_s`, from the last second that was driven, as the sweep samples but without its guidance. Other traffic
/// arrives and leaves, as in `djinn drive`. Until the requested event has happened, its other agents follow the sample,
/// faster or slower where the ego would undo it. A template is solved for up to five seconds, so that it takes the time
/// that people take, and its agents follow it beyond the end of the sample. Samples without the requested event stay as
/// they are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SweepRollout {
    /// Its length after the present, seconds. It ends earlier where the ego hits somebody or leaves the road after the
    /// end of the sample.
    #[schemars(range(max = 600.0), extend("exclusiveMinimum" = 0))]
    pub horizon_s: f64,
    /// How long each plan is driven, seconds. Both times are multiples of the timestep, and the model sees this far.
    #[schemars(range(min = 0.01))]
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

    /// The timesteps for which the template of a scene is solved.
    pub(super) fn n_timesteps_planned(&self, scene: &Scene) -> usize {
        let n_driven = (self.horizon_s.min(MANEUVER_S) / scene.dt_s).round() as usize;
        scene.n_timesteps.max(scene.n_history + n_driven)
    }

    /// Rejects what cannot be driven with timesteps of `dt_s` and a model that sees `future_s` ahead.
    pub fn check(&self, dt_s: f64, future_s: f64) -> Result {
        check_times([self.horizon_s, self.replan_s], [dt_s, future_s])
    }

    /// How often futures are sampled anew, if both times are multiples of the timestep.
    pub(super) fn n_replans(&self) -> u64 {
        (self.horizon_s / self.replan_s - 1e-6).floor() as u64
    }
}

/// Rejects a closed loop of `horizon_s` in plans of `replan_s` that has no whole timesteps of `dt_s`, or plans farther
/// than a model that sees `future_s` ahead.
pub fn check_times([horizon_s, replan_s]: [f64; 2], [dt_s, future_s]: [f64; 2]) -> Result {
    for (key, time_s) in [("horizon_s", horizon_s), ("replan_s", replan_s)] {
        let n_steps = time_s / dt_s;
        let is_whole = n_steps.round() >= 1.0 && (n_steps - n_steps.round()).abs() < 1e-6;
        if !is_whole {
            let expected = format_args!("is {time_s:?}, expected a multiple of the timestep, which is {dt_s} s");
            return Err(Issue::new(key, expected));
        }
    }
    match replan_s <= future_s + 1e-6 {
        true => Ok(()),
        false => {
            let why = format!("is {replan_s:?}, expected at most the {future_s} s that the model sees ahead");
            Err(Issue::new("replan_s", why))
        }
    }
}

/// A driver that needs no planner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NamedDriver {
    /// The model, as for everybody else.
    #[default]
    Model,
    /// The states of the scenario; after its end, a calmer `idm`.
    Log,
    /// The path of the scenario at the present speed.
    ConstantVelocity,
    /// The path of the scenario by the intelligent driver model.
    Idm,
    /// The careful driver of UN Regulation No. 157 on the path of the scenario.
    Careful,
}

named! { NamedDriver {
    Model = "model", Log = "log", ConstantVelocity = "constant_velocity", Idm = "idm", Careful = "careful",
} }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_counted_after_the_first() {
        let n =
            |horizon_s: f64, replan_s: f64| SweepRollout { horizon_s, replan_s, ..SweepRollout::default() }.n_replans();
        assert_eq!([n(8.0, 0.5), n(3.0, 3.0), n(1.2, 0.5), n(0.9, 0.3)], [15, 0, 2, 2]);
        let refused = |horizon_s: f64, replan_s: f64| {
            SweepRollout { horizon_s, replan_s, ..SweepRollout::default() }
                .check(0.1, 3.0)
                .map_or_else(|issue| issue.to_string(), |()| String::new())
        };
        assert_eq!([refused(8.0, 0.3), refused(600.0, 3.0), refused(0.1, 0.1)], [""; 3]);
        for (found, why) in [
            (refused(8.0, 0.25), "replan_s is 0.25, expected a multiple of the timestep, which is 0.1 s"),
            (refused(8.0, 1e-300), "replan_s is 1e-300, expected a multiple"),
            (refused(8.04, 0.5), "horizon_s is 8.04, expected a multiple"),
            (refused(8.0, 3.1), "replan_s is 3.1, expected at most the 3 s that the model sees ahead"),
        ] {
            assert!(found.contains(why), "{found}");
        }
        // A maneuver takes up to five seconds.
        let scene = crate::scene::testing::scene(&[]);
        let planned = [0.1, 3.0, 8.0].map(|horizon_s| SweepRollout { horizon_s, ..SweepRollout::default() });
        assert_eq!(planned.map(|rollout| rollout.n_timesteps_planned(&scene)), [12, 4 + 30, 4 + 50]);
        assert!(SweepRollout { replan_s: 9.0, ..SweepRollout::default() }.validate().is_err());
    }
}
