//! The figures of the careful driver, in one place, with their sources.
//!
//! UN Regulation No. 157 (automated lane keeping systems), annex 3: *guidance on traffic disturbance critical
//! scenarios*, with the performance model of a careful human driver for cut-ins, cut-outs and decelerations, and
//! paragraph 5.2.5 with what a system must avoid. What the regulation leaves open is marked as ours.

/// A vehicle that moves sideways by at most this only wanders in its lane: beyond it, the risk of a cut-in or cut-out
/// can be perceived, meters.
pub(crate) const WANDERING_M: f64 = 0.375;
/// A vehicle ahead that brakes by more than this is a risk, m/s².
pub(super) const LEADER_BRAKES_MPS2: f64 = 5.0;
/// Time to perceive a risk, seconds.
pub(super) const PERCEPTION_S: f64 = 0.4;
/// A time to collision of at most this is dangerous after a cut-in; a headway of at most this if the vehicle ahead cuts
/// out or brakes, seconds.
pub(super) const DANGER_S: f64 = 2.0;
/// Time from a danger that is perceived to braking, seconds.
pub(crate) const DELAY_S: f64 = 0.75;
/// Time for the deceleration to reach its maximum, seconds.
pub(super) const RAMP_S: f64 = 0.6;
/// The largest deceleration, m/s²: 0.774 g. (The 0.85 g of systems with emergency braking, once both vehicles are in
/// line, are not modeled.)
pub(super) const MAX_DECELERATION_MPS2: f64 = 7.593;
/// Width of a lane, meters: its markings are half of it from the path.
pub(super) const LANE_WIDTH_M: f64 = 3.5;

/// Paragraph 5.2.5.2: a vehicle this far beyond the marking intrudes, meters.
pub(super) const INTRUSION_M: f64 = 0.3;
/// Its motion across must have been visible for this long before, seconds.
pub(super) const VISIBLE_S: f64 = 0.72;
/// The deceleration in the bound on the time to collision at the intrusion, m/s².
pub(super) const BOUND_DECELERATION_MPS2: f64 = 6.0;
pub(super) const BOUND_DELAY_S: f64 = 0.35;

/// Paragraph 5.2.5.2: the time to collision at the intrusion of a vehicle that is slower by this, m/s, beyond which a
/// collision must be avoided, seconds.
pub(crate) fn least_ttc_s(closing_mps: f64) -> f64 {
    closing_mps / (2.0 * BOUND_DECELERATION_MPS2) + BOUND_DELAY_S
}

/// Paragraph 5.2.5.3 demands that a collision with a pedestrian in view who crosses at up to 5 km/h be avoided at up to
/// 60 km/h, and has no model of a driver. Ours: whoever walks toward the path at least this fast, m/s, is a risk, which
/// is perceived, and answered, as any other; may soon walk as fast as in that paragraph; and is a danger as soon as
/// stopping takes as far, with this much to spare, meters.
pub(super) const WALKS_MPS: f64 = 0.5;
/// See [`WALKS_MPS`]: 5 km/h.
pub(super) const CROSSES_MPS: f64 = 5.0 / 3.6;
/// See [`WALKS_MPS`].
pub(super) const SPARE_M: f64 = 1.0;
