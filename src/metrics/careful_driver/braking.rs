//! Distance and speed of a braking driver over time.

use super::regulation::{MAX_DECELERATION_MPS2, RAMP_S};

/// Constant speed, then a deceleration that grows linearly to its maximum and stays there until the vehicle stands.
pub(super) struct Braking {
    /// Speed before braking, m/s.
    pub(super) speed_mps: f64,
    /// When braking begins, seconds since the present; `None` for never.
    pub(super) from_s: Option<f64>,
    /// Time for the deceleration to reach its maximum, seconds.
    pub(super) ramp_s: f64,
    /// The largest deceleration, m/s².
    pub(super) max_deceleration_mps2: f64,
}

impl Braking {
    /// The braking of the careful driver.
    pub(super) const fn careful(speed_mps: f64, from_s: Option<f64>) -> Self {
        Self { speed_mps, from_s, ramp_s: RAMP_S, max_deceleration_mps2: MAX_DECELERATION_MPS2 }
    }

    /// When the vehicle stands, seconds since the present. `None` if it never does.
    pub(super) fn stands_from_s(&self) -> Option<f64> {
        let (from_s, &Self { ramp_s, max_deceleration_mps2, .. }) = (self.from_s?, self);
        // The ramp reduces the speed by half as much as full braking would.
        let lost_mps = max_deceleration_mps2 * ramp_s / 2.0;
        Some(match self.speed_mps > lost_mps {
            true => from_s + ramp_s + (self.speed_mps - lost_mps) / max_deceleration_mps2,
            false => from_s + (2.0 * self.speed_mps * ramp_s / max_deceleration_mps2).sqrt(),
        })
    }

    /// Speed at a time, m/s.
    pub(super) fn speed_mps(&self, time_s: f64) -> f64 {
        if self.stands_from_s().is_some_and(|stands_s| time_s >= stands_s) {
            return 0.0;
        }
        let (ramping_s, full_s) = self.phases_s(time_s);
        let a = self.max_deceleration_mps2;
        (self.speed_mps - a * ramping_s * ramping_s / (2.0 * self.ramp_s) - a * full_s).max(0.0)
    }

    /// Distance driven since the present, meters.
    pub(super) fn driven_m(&self, time_s: f64) -> f64 {
        let time_s = self.stands_from_s().map_or(time_s, |stands_s| time_s.min(stands_s));
        let (ramping_s, full_s) = self.phases_s(time_s);
        let (a, ramp_s) = (self.max_deceleration_mps2, self.ramp_s);
        // ∫ of the speed: the cubic of the ramp, the speed lost in the ramp since, and the parabola of full braking.
        let lost_mps = a * ramping_s * ramping_s / (2.0 * ramp_s);
        self.speed_mps * time_s - a * ramping_s.powi(3) / (6.0 * ramp_s) - lost_mps * full_s - a * full_s * full_s / 2.0
    }

    /// The time by then spent in the ramp, and in full braking.
    fn phases_s(&self, time_s: f64) -> (f64, f64) {
        let braking_s = self.from_s.map_or(0.0, |from_s| (time_s - from_s).max(0.0));
        (braking_s.min(self.ramp_s), (braking_s - self.ramp_s).max(0.0))
    }
}
