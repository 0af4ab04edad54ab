//! Collision courses: the time to collision, the exposure, and the braking needed.

use super::agent::MovingAgent;
use crate::behavior::footprint::Footprint;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::geometry::Vec2;
use std::ops::Range;

/// Times to collision beyond this are meaningless, because nobody keeps course and speed for that long, seconds.
const MAX_TTC_S: f64 = 10.0;
/// Times to collision below this count as exposure, seconds.
const EXPOSURE_TTC_S: f64 = 1.5;
/// More than any brake achieves: at larger rates, too, braking does not avoid the crash, m/s².
pub(super) const MAX_DRAC_MPS2: f64 = 20.0;

/// The measures of two agents' courses over some timesteps. [The module](super) has the definitions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Closing {
    pub(super) min_ttc_s: Option<f64>,
    pub(super) max_drac_mps2: f64,
    pub(super) tet_s: f64,
    pub(super) tit_s2: f64,
}

/// Both agents at one timestep.
type Meeting<'a> = [(&'a Footprint, Vec2); 2];

fn meetings<'a>(
    first: &'a MovingAgent,
    second: &'a MovingAgent,
    timesteps: Range<usize>,
) -> impl Iterator<Item = Meeting<'a>> {
    first.sweep.both_at(&second.sweep, timesteps).filter_map(|(timestep, one, other)| {
        Some([(one, first.velocity(timestep)?), (other, second.velocity(timestep)?)])
    })
}

/// Time to collision and the deceleration rate that avoids it; `None` if the agents would not collide within the
/// longest time.
fn ttc_and_drac([(one, own), (other, theirs)]: Meeting<'_>) -> Option<(f64, f64)> {
    let ttc_s = time_to_collision_s(one, own, other, theirs).filter(|ttc_s| *ttc_s <= MAX_TTC_S)?;
    let drac_mps2 = (own - theirs).norm() / (2.0 * ttc_s);
    // For boxes that overlap, this divides by zero.
    Some((ttc_s, if drac_mps2 < MAX_DRAC_MPS2 { drac_mps2 } else { MAX_DRAC_MPS2 }))
}

impl Closing {
    /// The measures of two agents over `timesteps`.
    pub(super) fn over(first: &MovingAgent, second: &MovingAgent, timesteps: Range<usize>, dt_s: f64) -> Self {
        let mut closing = Self::default();
        for meeting in meetings(first, second, timesteps) {
            let Some((ttc_s, drac_mps2)) = ttc_and_drac(meeting) else { continue };
            closing.add(ttc_s, drac_mps2);
            if ttc_s < EXPOSURE_TTC_S {
                closing.tet_s += dt_s;
                closing.tit_s2 += (EXPOSURE_TTC_S - ttc_s) * dt_s;
            }
        }
        closing
    }

    /// The worst of this and of two agents, exposure aside. Exact: a timestep is skipped only if the distance between
    /// the circles around the boxes rules out anything worse.
    pub(super) fn worst_with(mut self, first: &MovingAgent, second: &MovingAgent, timesteps: Range<usize>) -> Self {
        for meeting in meetings(first, second, timesteps) {
            let [(one, own), (other, theirs)] = meeting;
            let (least_m, relative_mps) = (one.distance_lower_bound_m(other), (own - theirs).norm());
            let could_be_sooner = least_m <= relative_mps * self.min_ttc_s.unwrap_or(MAX_TTC_S);
            let could_be_harder =
                self.max_drac_mps2 < MAX_DRAC_MPS2 && least_m * 2.0 * self.max_drac_mps2 <= relative_mps * relative_mps;
            if (could_be_sooner || could_be_harder)
                && let Some((ttc_s, drac_mps2)) = ttc_and_drac(meeting)
            {
                self.add(ttc_s, drac_mps2);
            }
        }
        self
    }

    fn add(&mut self, ttc_s: f64, drac_mps2: f64) {
        self.min_ttc_s = Some(self.min_ttc_s.map_or(ttc_s, |least_s| least_s.min(ttc_s)));
        self.max_drac_mps2 = self.max_drac_mps2.max(drac_mps2);
    }
}
