//! Does one agent cross where another was shortly before?

use super::box_separation::separation_between_m;
use super::motion::{norm, penalty, positions};
use super::pairs::{self, Agents};
use candle_core::{D, DType, Result, Tensor};

/// How much the boxes must overlap, at their two times, meters; smoothing makes their separation up to 0.2 m less than
/// it is.
const OVERLAP_M: f64 = 0.7;
/// The distance to overlapping that costs ½, meters.
const DISTANCE_TOLERANCE_M: f64 = 0.5;
/// Courses cross if their headings differ by more than this: cos 45°.
const CROSSING_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// The excess of the cosine that costs ½.
const COS_TOLERANCE: f64 = 0.15;
/// Both move at least this fast, m/s; falling short by this costs ½.
const LEAST_SPEED_MPS: f64 = 2.0;
const SPEED_TOLERANCE_MPS: f64 = 1.0;

/// Places of one agent of each pair, and of the other k timesteps later, for all target k.
///
/// With s the separation of the boxes at their two times, Δψ the difference of headings and v the speeds, a pair of
/// moments costs c = ½ (\[s + 0.7 m\]₊ / 0.5 m)² + ½ (\[cos Δψ - cos 45°\]₊ / 0.15)² + ½ Σ (\[2 m/s - v\]₊ / 1 m/s)².
pub(super) struct Encroachment {
    /// (P, N).
    pub(super) costs: Tensor,
    /// 1 if both have a state, one of which is generated, and the time between them is in the target, (P, N).
    pub(super) counts: Tensor,
}

impl Encroachment {
    /// From pairs (earlier agent, later agent), for post-encroachment times between the least and the most `wanted_s`
    /// of each pair, (P, 2). Each of `orders` has the same pairs. `None` if no two timesteps are that far apart.
    pub(super) fn new(orders: &[[&Agents; 2]], wanted_s: &Tensor, dt_s: f64) -> Result<Option<Self>> {
        let n_timesteps = orders[0][0].valid.dim(1)?;
        let wanted = wanted_s.to_dtype(DType::F64)?.to_vec2::<f64>()?;
        // Timesteps are points: half of their spacing belongs to each.
        let is_wanted = |delay: usize, pet_s: &[f64]| {
            (pet_s[0] - dt_s / 2.0..=pet_s[1] + dt_s / 2.0).contains(&(delay as f64 * dt_s))
        };
        let (mut costs, mut counts) = (Vec::new(), Vec::new());
        for delay in 1..n_timesteps.saturating_sub(1) {
            let of_pairs: Vec<f64> = wanted.iter().map(|pet_s| f64::from(u8::from(is_wanted(delay, pet_s)))).collect();
            if of_pairs.iter().all(|wanted| *wanted == 0.0) {
                continue;
            }
            let of_pairs =
                Tensor::from_vec(of_pairs, (wanted.len(), 1), wanted_s.device())?.to_dtype(wanted_s.dtype())?;
            for [earlier, later] in orders {
                // From the second timestep on: the first has no speed.
                let len = n_timesteps - 1 - delay;
                let before = [earlier.during(0, len)?, later.during(delay, len)?];
                let [earlier, later] = [earlier.during(1, len)?, later.during(1 + delay, len)?];
                let valid = (&before[0].valid * &before[1].valid)?;
                counts.push((pairs::counts(&earlier, &later)? * valid)?.broadcast_mul(&of_pairs)?);
                costs.push(cost([&earlier, &later], &before, dt_s)?);
            }
        }
        if costs.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self { costs: Tensor::cat(&costs, 1)?, counts: Tensor::cat(&counts, 1)? }))
    }
}

/// The cost c of each timestep of two agents, which were at `before` one timestep earlier: (P, N).
fn cost([one, other]: [&Agents; 2], before: &[Agents; 2], dt_s: f64) -> Result<Tensor> {
    let heading = |agents: &Agents| agents.states.narrow(D::Minus1, 2, 1)?.squeeze(D::Minus1);
    let along = ((heading(one)? - heading(other)?)?.cos()? - CROSSING_COS)?.relu()?;
    let apart_m = (separation_between_m(one, other)? + OVERLAP_M)?.relu()?;
    let slow = |agents: &Agents, before: &Agents| -> Result<Tensor> {
        let speed_mps = (norm(&(positions(&agents.states)? - positions(&before.states)?)?)? * (1.0 / dt_s))?;
        penalty(&(LEAST_SPEED_MPS - speed_mps)?.relu()?, SPEED_TOLERANCE_MPS)
    };
    let costs = (penalty(&apart_m, DISTANCE_TOLERANCE_M)? + penalty(&along, COS_TOLERANCE)?)?;
    (costs + (slow(one, &before[0])? + slow(other, &before[1])?)?)?.neg()
}
