//! One vehicle behind another, row by row: the gap between them, and their speeds.

use super::SceneContext;
use super::motion::{norm, positions};
use super::pairs::Agents;
use candle_core::{Result, Tensor};

/// Two of a row at the timesteps from the second on, each (B, T - 1).
pub(super) struct Chase {
    /// The way between the centers less half of both lengths, meters: the gap along the lane, but for bends of a radius near its length.
    pub(super) gap_m: Tensor,
    /// Speed of the one behind, which led there, m/s.
    pub(super) own_mps: Tensor,
    /// Speed of the one ahead, m/s.
    pub(super) their_mps: Tensor,
    /// 1 where both have a state then and at the timestep before.
    pub(super) valid: Tensor,
    /// The same where one of these states is generated.
    pub(super) counts: Tensor,
}

impl Chase {
    /// Of `behind` and `ahead`. There must be two timesteps.
    pub(super) fn new(behind: &Agents, ahead: &Agents, context: &SceneContext) -> Result<Self> {
        let n_steps = behind.valid.dim(1)? - 1;
        let [(earlier, before), (own, theirs)] =
            [0, 1].map(|start| (behind.during(start, n_steps), ahead.during(start, n_steps)));
        let (earlier, before, own, theirs) = (earlier?, before?, own?, theirs?);
        let speed_mps = |now: &Agents, before: &Agents| -> Result<Tensor> {
            norm(&(positions(&now.states)? - positions(&before.states)?)?)? * (1.0 / context.dt_s)
        };
        let half_lengths_m = ((behind.extent_m.narrow(1, 0, 1)? + ahead.extent_m.narrow(1, 0, 1)?)? * 0.5)?;
        let distance_m = norm(&(positions(&theirs.states)? - positions(&own.states)?)?)?;
        let all = [&earlier, &before, &own, &theirs];
        let product = |of: fn(&Agents) -> Result<Tensor>| {
            all[1..].iter().try_fold(of(all[0])?, |product, agents| product * of(agents)?)
        };
        let (valid, known) = (product(|agents| Ok(agents.valid.clone()))?, product(|agents| 1.0 - &agents.latent)?);
        Ok(Self {
            gap_m: distance_m.broadcast_sub(&half_lengths_m)?,
            own_mps: speed_mps(&own, &earlier)?,
            their_mps: speed_mps(&theirs, &before)?,
            counts: (&valid * (1.0 - known)?)?,
            valid,
        })
    }
}

/// By how much the way `gap_m` (B, N) is more or less than what one drives at `speed_mps` (B, N) in the times of its row, (B, 2), meters.
pub(super) fn beyond_times(gap_m: &Tensor, speed_mps: &Tensor, times_s: &Tensor) -> Result<Tensor> {
    let (least_m, most_m) =
        (speed_mps.broadcast_mul(&times_s.narrow(1, 0, 1)?)?, speed_mps.broadcast_mul(&times_s.narrow(1, 1, 1)?)?);
    (least_m - gap_m)?.relu()? + (gap_m - most_m)?.relu()?
}
