//! The intelligent driver model (Treiber, Hennecke and Helbing 2000): how drivers keep their distance.

use super::Seen;

/// Time headway, seconds; least gap, meters; acceleration and comfortable deceleration, m/s².
const HEADWAY_S: f64 = 1.5;
const LEAST_GAP_M: f64 = 2.0;
const ACCELERATES_MPS2: f64 = 1.5;
pub(super) const BRAKES_MPS2: f64 = 2.0;
/// Full braking, m/s².
const MOST_MPS2: f64 = 8.0;
/// Whoever is this close to the flank of the ego, meters, is in its way.
const MARGIN_M: f64 = 0.2;
/// The fastest change of the acceleration by ordinary drivers, m/s³: as the careful driver brakes.
const JERK_MPS3: f64 = 12.65;

/// Half the width that an ego of this width needs, meters.
pub(crate) fn half_width_m(ego_width_m: f64) -> f64 {
    ego_width_m / 2.0 + MARGIN_M
}

impl Seen {
    /// Whether it is ahead in the way of an ego that needs this width to either side.
    pub(crate) fn leads(&self, half_width_m: f64) -> bool {
        self.flank_m < half_width_m && self.gap_m > -self.lengths_m / 2.0
    }
}

/// The model's acceleration at this speed behind these leaders, if the driver would like to drive at `wanted_mps`,
/// m/s²; without leaders, that on a free road.
pub(crate) fn acceleration_mps2(speed_mps: f64, wanted_mps: f64, leaders: impl Iterator<Item = Seen>) -> f64 {
    let free = (1.0 - (speed_mps / wanted_mps.max(1.0)).powi(4)).max(-BRAKES_MPS2 / ACCELERATES_MPS2);
    let held = leaders.map(|seen| {
        let closing_m = speed_mps * seen.closing_mps / (2.0 * (ACCELERATES_MPS2 * BRAKES_MPS2).sqrt());
        let wanted_m = LEAST_GAP_M + (speed_mps * HEADWAY_S + closing_m).max(0.0);
        (wanted_m / seen.gap_m.max(0.1)).powi(2)
    });
    (ACCELERATES_MPS2 * (free - held.fold(0.0, f64::max))).max(-MOST_MPS2)
}

/// The acceleration that a driver who wants this one arrives at within a timestep after `own_mps2`, m/s².
pub(crate) fn eased_mps2(wanted_mps2: f64, own_mps2: f64, dt_s: f64) -> f64 {
    wanted_mps2.clamp(own_mps2 - JERK_MPS3 * dt_s, own_mps2 + JERK_MPS3 * dt_s)
}
