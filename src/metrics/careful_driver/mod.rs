//! Could a careful driver have prevented a collision after a cut-in? The performance model of UN Regulation No. 157.
//!
//! The driver of Annex 3 (guidance on traffic disturbance critical scenarios, cut-in) takes the place of the ego, with
//! the ego's speed at present and on its future path. The other moves as in the scene, and after the end of the scene
//! at its last velocity.
//!
//! 1. *Perception.* Within 0.375 m of its place in its lane a vehicle only wanders. Once it has come closer to the path
//!    than that, it takes 0.4 s to see that it cuts in. Maps need not show lanes, so its place is where it was farthest
//!    from the path up to then.
//! 2. *Danger.* The driver reacts when, from then on, the time to collision along the path is 2 s or less.
//! 3. *Reaction.* 0.75 s later it brakes: the deceleration grows evenly over 0.6 s to 0.774 g, that is by 12.65 m/s³,
//!    and stays.
//!
//! The cut-in is preventable if the boxes do not touch before the driver is no faster than the other, or stands. A
//! driver without a reason to react keeps its speed. Steering is not modeled, nor is the regulation's stronger braking
//! once both vehicles are in line.
//!
//! Paragraph 5.2.5.2 has a simple bound, too: a collision must be avoided if, when the other is 0.3 m beyond the lane
//! marking, the time to collision exceeds v_rel / (2 · 6 m/s²) + 0.35 s. The marking is assumed to be half a lane's
//! width beside the path.

mod braking;
mod encounter;
mod ending;
mod preventable_rate;
mod regulation;
#[cfg(test)]
mod tests;
mod watch;

pub use ending::Ending;
pub use preventable_rate::PreventableRate;
pub use watch::{CarefulWatch, Seen};

use crate::scene::Scene;
use braking::Braking;
use encounter::Encounter;
use regulation::{BOUND_DECELERATION_MPS2, BOUND_DELAY_S, DELAY_S};
use serde::{Deserialize, Serialize};

/// The judgment of a cut-in by the regulation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CutInJudgment {
    /// Whether the careful driver avoids the collision.
    pub preventable: bool,
    /// When it begins to brake, seconds since the present; `None` if it does not.
    pub braking_from_s: Option<f64>,
    /// Time to collision at the intrusion, seconds; `None` if the gap does not close then.
    pub intrusion_ttc_s: Option<f64>,
    /// Whether the simple bound requires that a collision be avoided; `None` if the other is alongside at the
    /// intrusion, where the bound does not apply.
    pub avoidance_required: Option<bool>,
}

impl CutInJudgment {
    /// Judges how `other` cuts in before `ego`, given by their indices; `None` if either is not tracked at present, or
    /// the other does not enter the ego's lane in the future.
    pub fn of(scene: &Scene, [ego, other]: [usize; 2]) -> Option<Self> {
        let encounter = Encounter::of(scene, [ego, other])?;
        let intrusion = encounter.intrusion()?;
        let perceived_s = encounter.perceived_s();
        let danger_s = perceived_s.and_then(|perceived_s| encounter.danger_s(perceived_s));
        let braking_from_s = danger_s.map(|danger_s| (danger_s + DELAY_S).max(0.0));
        let braking = Braking::careful(encounter.ego_speed_mps, braking_from_s);
        let closing_mps = intrusion.ego_speed_mps - intrusion.other_speed_mps;
        let intrusion_ttc_s = (closing_mps > 0.0 && intrusion.gap_m >= 0.0).then(|| intrusion.gap_m / closing_mps);
        let bound_s = closing_mps / (2.0 * BOUND_DECELERATION_MPS2) + BOUND_DELAY_S;
        Some(Self {
            preventable: !encounter.touches(&braking),
            braking_from_s,
            intrusion_ttc_s,
            avoidance_required: (intrusion.gap_m >= 0.0).then(|| intrusion_ttc_s.is_none_or(|ttc_s| ttc_s > bound_s)),
        })
    }
}
