//! The validity checks, and violations of them.

use crate::scene::{Scene, TrackId};
use crate::settings::named;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A check. Names in configs and tables are those of [`Check::id`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Check {
    /// A vehicle speeds up harder than engines can.
    Acceleration,
    /// A vehicle brakes harder than tires can.
    Deceleration,
    /// A vehicle takes a bend faster than tires can.
    LateralAcceleration,
    /// A vehicle's acceleration changes faster than pedals and steering can make it.
    Jerk,
    /// A vehicle turns faster than vehicles do.
    YawRate,
    /// A vehicle turns more tightly than its steering allows at its speed, or on the spot.
    Curvature,
    /// A vehicle does not move in the direction of its heading.
    Heading,
    /// A vehicle drives backward.
    Reverse,
    /// A road user jumps where given and generated states meet.
    StartPosition,
    /// A road user turns at once where given and generated states meet.
    StartHeading,
    /// The acceleration of a vehicle in motion changes at once where given and generated states meet.
    StartAcceleration,
    /// Two road users drive into each other.
    Collision,
    /// A vehicle leaves the road.
    Offroad,
    /// Nobody is left on the road.
    Deserted,
    /// The subject of the requested event is about to drive into somebody, too late to avoid it.
    ContactAfterEnd,
}

named! { Check {
    Acceleration = "acceleration", Deceleration = "deceleration", LateralAcceleration = "lateral_acceleration",
    Jerk = "jerk", YawRate = "yaw_rate", Curvature = "curvature", Heading = "heading", Reverse = "reverse",
    StartPosition = "start_position", StartHeading = "start_heading", StartAcceleration = "start_acceleration",
    Collision = "collision", Offroad = "offroad", Deserted = "deserted", ContactAfterEnd = "contact_after_end",
} }

impl Check {
    /// The unit of its values and limits.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Acceleration | Self::Deceleration | Self::LateralAcceleration | Self::StartAcceleration => "m/s^2",
            Self::Jerk => "m/s^3",
            Self::YawRate | Self::Curvature => "rad/s",
            Self::Heading | Self::StartHeading => "rad",
            Self::Reverse | Self::StartPosition | Self::Offroad => "m",
            Self::Deserted => "s",
            Self::Collision | Self::ContactAfterEnd => "m/s",
        }
    }

    /// The meaning of its value in a line.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Acceleration => "a vehicle speeds up by more than the limit, along its motion",
            Self::Deceleration => "a vehicle brakes by more than the limit, along its motion",
            Self::LateralAcceleration => "a vehicle accelerates by more than the limit across its motion",
            Self::Jerk => "a vehicle's acceleration changes by more than the limit, in any direction",
            Self::YawRate => "a vehicle's heading turns faster than the limit",
            Self::Curvature => "a vehicle's heading turns faster than its tightest circle allows at its speed",
            Self::Heading => {
                "a vehicle moves at an angle to its heading that is larger than its turning explains, by more than the \
                 limit beyond the largest such angle among its given states"
            }
            Self::Reverse => {
                "a vehicle goes back by more than the limit, which it was not seen to do in its given states"
            }
            Self::StartPosition => {
                "a road user is farther than the limit from where its motion leads, where given and generated states \
                 meet"
            }
            Self::StartHeading => {
                "a road user turns by more than the limit in one timestep, where given and generated states meet"
            }
            Self::StartAcceleration => {
                "a vehicle in motion changes its acceleration within two timesteps, where given and generated states \
                 meet, by more than the limit beyond the largest such change among its given states"
            }
            Self::Collision => "two road users touch that did not at present; the value is their relative speed",
            Self::Offroad => "a vehicle that is on the road at present leaves it by more than the limit",
            Self::Deserted => "all have left, and for longer than the limit nobody arrives until the end",
            Self::ContactAfterEnd => {
                "within a second after the end, the subject of the requested event touches somebody ahead of it if all \
                 go on, although a careful driver takes over at the last state; the value is their relative speed"
            }
        }
    }
}

/// A check that a scene failed, at its worst place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// The check.
    pub check: Check,
    /// The agent at fault; of a collision the first of the two.
    pub track: TrackId,
    /// When.
    pub timestep: usize,
    /// The value, in the check's unit.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

impl Violation {
    pub(in crate::metrics) fn new(
        check: Check,
        scene: &Scene,
        agent_idx: usize,
        timestep: usize,
        (value, limit): (f64, f64),
    ) -> Self {
        Self { check, track: scene.tracks[agent_idx].id.clone(), timestep, value, limit }
    }

    /// How far the value is beyond its limit; infinite for NaN.
    pub(super) fn excess(&self) -> f64 {
        if self.value.is_nan() { f64::INFINITY } else { self.value - self.limit }
    }
}

/// Whether `value` breaks `limit`; NaN does.
pub(super) fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value > limit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn what_is_no_number_is_the_worst() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
        let excess = |value: f64| Violation::new(Check::Jerk, &scene, 0, 5, (value, 2.0)).excess();
        assert_eq!((excess(5.0), excess(f64::NAN)), (3.0, f64::INFINITY));
    }
}
