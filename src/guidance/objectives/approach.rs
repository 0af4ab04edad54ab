//! How soon two agents would collide, and how far beside each other they would pass.

use super::box_separation::separation_m;
use super::motion::{norm, positions};
use super::pairs::{Agents, PairQuery, Pairs};
use super::{AgentSelector, SceneContext};
use candle_core::{D, Result, Tensor};

/// The gap below which time to collision no longer shrinks, meters: its inverse would grow without bound.
const LEAST_GAP_M: f64 = 0.5;
/// Whose boxes would overlap by less than this grazes the other, meters.
const OVERLAP_M: f64 = 0.6;
/// How long one goes straight on who is on a straight course, seconds.
const STRAIGHT_S: f64 = 0.8;
/// Rounding of the way beside a course at zero, meters.
const ROUNDING_M: f64 = 0.05;
/// Rounding of the distance of passing at zero, in meters times m/s.
const SMALL: f64 = 0.05;

/// Pairs at the timesteps from the second on, with the velocity that led there, both going straight on: (P, T - 1) each.
pub(super) struct Approach {
    /// The inverse time to collision q = -(d · u / ‖d‖) / (max(s, 0) + ½ m), of relative position d, relative velocity u and separation s, 1/s.
    pub(super) inverse_ttc_per_s: Tensor,
    /// The relative speed ‖u‖, m/s.
    pub(super) relative_mps: Tensor,
    /// By how much the centers would pass each other farther apart than half of both widths less what they are to overlap, meters.
    pub(super) aside_m: Tensor,
    /// By how much each of the two leaves its straight course within the next [`STRAIGHT_S`], meters, summed: who drives around a bend is on no
    /// course to collide with those beyond it.
    pub(super) swerve_m: Tensor,
    /// 1 where both timesteps have states of both, of which one is generated.
    pub(super) counts: Tensor,
}

impl Approach {
    /// Of the pair of `one` and `other` in each row, with the pairs and the separation of their boxes, (P, T). `None` where there is no such pair, or
    /// only one timestep.
    pub(super) fn between(
        states: &Tensor,
        context: &SceneContext,
        [one, other]: [&AgentSelector; 2],
    ) -> Result<Option<(Pairs, Tensor, Self)>> {
        let query = PairQuery::of(one, other);
        let Some(pairs) = Pairs::gather(states, context, &query)?.filter(|_| states.dim(2).is_ok_and(|n| n > 1)) else {
            return Ok(None);
        };
        let separation_m = separation_m(&pairs)?;
        let approach = Self::new(&pairs, &separation_m, context.dt_s)?;
        Ok(Some((pairs, separation_m, approach)))
    }

    /// Of `pairs`, whose boxes are `separation_m` (P, T) apart. There must be two timesteps.
    fn new(pairs: &Pairs, separation_m: &Tensor, dt_s: f64) -> Result<Self> {
        let n_steps = separation_m.dim(1)? - 1;
        let (earlier, later) =
            (|tensor: &Tensor| tensor.narrow(1, 0, n_steps), |tensor: &Tensor| tensor.narrow(1, 1, n_steps));
        let between = (positions(&pairs.second.states)? - positions(&pairs.first.states)?)?;
        let offset = later(&between)?;
        let relative = ((&offset - earlier(&between)?)? * (1.0 / dt_s))?;
        let (distance_m, speed_mps) = (norm(&offset)?, norm(&relative)?);
        let closing_mps = (&offset * &relative)?.sum(D::Minus1)?.neg()?.div(&distance_m)?;
        let gap_m = (later(separation_m)?.relu()? + LEAST_GAP_M)?;
        let cross = cross(&offset, &relative)?;
        let pass_m = ((cross.sqr()? + SMALL * SMALL)?.sqrt()?).div(&speed_mps)?;
        let width_m = ((pairs.first.extent_m.narrow(1, 1, 1)? + pairs.second.extent_m.narrow(1, 1, 1)?)? * 0.5)?;
        let swerve_m = (swerve_m(&pairs.first, n_steps, dt_s)? + swerve_m(&pairs.second, n_steps, dt_s)?)?;
        Ok(Self {
            swerve_m,
            inverse_ttc_per_s: closing_mps.div(&gap_m)?,
            relative_mps: speed_mps,
            aside_m: pass_m.broadcast_sub(&(width_m - OVERLAP_M)?)?.relu()?,
            counts: ((later(&pairs.counts)? + earlier(&pairs.counts)?)?.minimum(1.0)?
                * (later(&pairs.both_valid)? * earlier(&pairs.both_valid)?)?)?,
        })
    }
}

/// How far the agent of each pair is beside its course of each timestep from the second on some time later, meters, (P, T - 1): at most
/// [`STRAIGHT_S`] later, or at the end.
fn swerve_m(agents: &Agents, n_steps: usize, dt_s: f64) -> Result<Tensor> {
    let at = positions(&agents.states)?.contiguous()?;
    let later = (STRAIGHT_S / dt_s).round() as usize;
    let indices: Vec<u32> = (1..=n_steps).map(|t| (t + later).min(n_steps) as u32).collect();
    let ahead = at.index_select(&Tensor::from_vec(indices, n_steps, at.device())?, 1)?;
    let here = at.narrow(1, 1, n_steps)?;
    let (driven, course) = ((ahead - &here)?, (&here - at.narrow(1, 0, n_steps)?)?);
    (cross(&course, &driven)?.div(&norm(&course)?)?.sqr()? + ROUNDING_M * ROUNDING_M)?.sqrt()
}

/// x y' - y x' of vectors (.., 2).
fn cross(one: &Tensor, other: &Tensor) -> Result<Tensor> {
    let component = |tensor: &Tensor, dim: usize| tensor.narrow(D::Minus1, dim, 1)?.squeeze(D::Minus1);
    (component(one, 0)? * component(other, 1)?)? - (component(one, 1)? * component(other, 0)?)?
}
