//! Could a careful driver prevent a collision? The performance models of UN Regulation No. 157, in one implementation
//! for recorded, sampled and driven traffic.
//!
//! [`CarefulDriver`] is a function of what it has seen so far. On the way of the ego it drives as fast as the ego does
//! in the scene, and keeps its distance as ordinary drivers do, with at most 2 m/s², from whoever it has perceived
//! ahead in its way or coming there. Beside that it reacts to risks as the regulation's driver does:
//!
//! 1. *Perception.* A risk is perceived 0.4 s after it begins. *Cut-in:* a vehicle has come closer to the path by more
//!    than 0.375 m, or is in the lane; within that it only wanders. Maps need not show lanes, so its place is where it
//!    was farthest from the path up to then. *Cut-out:* the vehicle ahead, which hides those ahead of it, has left its
//!    place by more than 0.375 m. *Deceleration:* the vehicle ahead brakes with more than 5 m/s². *Pedestrian:*
//!    somebody walks toward the path; the regulation only says from when on a collision must be avoided, so this is
//!    ours.
//! 2. *Danger.* After a cut-in, if the time to collision along the path is at most 2 s; after a cut-out or
//!    deceleration, if the headway is; for a pedestrian, as soon as stopping takes as far, unless the ego has passed
//!    before.
//! 3. *Reaction.* 0.75 s later it brakes: the deceleration grows evenly over 0.6 s to 0.774 g, and stays until the
//!    danger is over: the other is out of the way or no slower, or the ego stands before a pedestrian.
//!
//! It does not steer. [`CarefulReplay`] drives it through a scene whose others move as they do there, and after its end
//! at their last velocities, while there is a danger. Contacts at its rear do not count: who follows does not answer
//! there. `margin_s` is by how much later it could react. Closed loops drive
//! the same driver among others that answer; what differs then is the world.
//!
//! Paragraph 5.2.5.2 has a simple bound, too: a collision must be avoided if a slower vehicle has moved across in sight
//! for 0.72 s, and when it is 0.3 m beyond the lane marking, the time to collision exceeds v_rel / (2 · 6 m/s²) + 0.35
//! s. The marking is assumed to be half a lane's width beside the path.

mod bends;
mod braking;
mod driver;
mod ending;
mod judgment;
mod ordinary;
mod preventable_rate;
mod regulation;
#[cfg(test)]
mod tests;
mod watch;
mod way;

pub use driver::CarefulDriver;
pub use ending::Ending;
pub use judgment::{CarefulJudgment, CarefulReplay};
pub(crate) use ordinary::{acceleration_mps2, eased_mps2, half_width_m};
pub use preventable_rate::PreventableRate;
pub(crate) use regulation::{DELAY_S, WANDERING_M, least_ttc_s};
pub use watch::Seen;
pub use way::Way;
pub(crate) use way::body;
