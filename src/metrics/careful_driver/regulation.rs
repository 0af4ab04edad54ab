//! The parameters of the careful driver of UN Regulation No. 157 (annex 3, appendix 3).

/// A vehicle that moves sideways by at most this only wanders in its lane, meters.
pub(super) const WANDERING_M: f64 = 0.375;
/// Time to perceive that a vehicle cuts in, seconds.
pub(super) const PERCEPTION_S: f64 = 0.4;
/// A time to collision of at most this is dangerous, seconds.
pub(super) const DANGER_TTC_S: f64 = 2.0;
/// Time from danger to braking, seconds.
pub(super) const DELAY_S: f64 = 0.75;
/// Time for the deceleration to reach its maximum, seconds.
pub(super) const RAMP_S: f64 = 0.6;
/// The largest deceleration, m/s²: 0.774 g.
pub(super) const MAX_DECELERATION_MPS2: f64 = 7.593;
/// Width of a lane, meters: its markings are half of it from the path.
pub(super) const LANE_WIDTH_M: f64 = 3.5;
/// A vehicle this far beyond the marking intrudes, meters.
pub(super) const INTRUSION_M: f64 = 0.3;
/// The deceleration in the bound on the time to collision at the intrusion, m/s².
pub(super) const BOUND_DECELERATION_MPS2: f64 = 6.0;
/// The delay in that bound, seconds.
pub(super) const BOUND_DELAY_S: f64 = 0.35;
