//! The limits of driving.

use crate::scene::Scene;

/// The accelerations of vehicles along their way, m/s².
pub(super) const ACCELERATIONS_MPS2: std::ops::RangeInclusive<f64> = -4.0..=2.5;
/// How long after it can see what comes a driver brakes, seconds: as UN Regulation No. 157 assumes, or, if that is too
/// late, as attentive drivers do who expect it (Green 2000: 0.7 to 0.75 s, of which less than half is perception).
pub(super) const REACTIONS_S: [f64; 2] = [0.75, 0.4];

/// The share of the limits that an acceleration uses.
pub(super) fn effort(acceleration_mps2: f64) -> f64 {
    let limit = if acceleration_mps2 < 0.0 { *ACCELERATIONS_MPS2.start() } else { *ACCELERATIONS_MPS2.end() };
    acceleration_mps2 / limit
}

/// The time from the present to the end of a scene, seconds.
pub(super) fn horizon_s(scene: &Scene) -> f64 {
    scene.n_timesteps.saturating_sub(scene.n_history) as f64 * scene.dt_s
}
