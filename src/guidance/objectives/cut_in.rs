//! Move into the lane of another agent, ahead of it.

use super::driven_paths::PathFrame;
use super::motion::{best_potential, nothing, penalty, unhurried};
use super::{AgentSelector, SceneContext, SceneObjective, Whose, beyond, ego, one_agent};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Move into the path of `before`, ahead of it, at a moment with the target gap and relative speed.
///
/// With d(t) the lateral offset of an agent from the path that `before` drives *in the sample*, carried straight on at
/// both ends, g(t) the gap along it from front to rear, u(t) the speed at which it closes, h half the sum of both
/// widths, and v the speed of `before`, a moment costs
///
/// c(t) = ½ ((|d| - h) / 0.5 m)² + ½ (\[g\] / τ)² + ½ (\[u\] / τ_u)² + ½ (max(g - 0.9 v Δ(t), 0) / τ)²,
///
/// where \[·\] is the distance to the target interval (`gap_m`, 1 to 30 m if there is none, and `relative_speed_mps`):
/// the boxes begin to share a path there, and `before` gets there within Δ(t), 3 s or the time that is left of the
/// scene. The best moment decides, smoothly: (Σ (c + δ)⁻⁴)^(-1/4) with δ = 0.01. To it comes the mean over the last
/// half second of ½ (max(|d| - (h - overlap), 0) / 0.5 m)² + ½ (max(1 m - g, 0) / τ)² + ½ (max(-|d|' - |d| / 0.8 s, 0)
/// / 0.1 m/s)²: who has moved over stays, in front, and comes no faster than it can settle there. And
/// ½ ∫ (max(|d'| - 1.2 m/s, 0) / 0.1 m/s)² dt: nobody moves over faster than drivers do.
///
/// `before` is taken as it is: nothing pulls at it, so that it does not move in behind the other instead. J = -(both),
/// and 0 where one of the two has no future.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CutIn {
    /// The agent whose path it enters: a role, or `ego`.
    #[serde(default = "ego")]
    pub before: AgentSelector,
}

/// The error τ_u of the relative speed that costs ½, m/s.
const TOLERANCE_MPS: f64 = 1.0;

/// The error τ of the gap that costs ½, meters.
const TOLERANCE_M: f64 = 1.0;

/// The parameters at which it aims, as the events report them.
const GAP: &str = "gap_m";
const RELATIVE_SPEED: &str = "relative_speed_mps";
/// The error of a lateral offset that costs ½, meters.
const LATERAL_TOLERANCE_M: f64 = 0.5;
/// The default gap, meters.
const ANY_GAP_M: [f64; 2] = [1.0, 30.0];
/// The default relative speed, m/s.
const ANY_SPEED_MPS: [f64; 2] = [-1e3, 1e3];
/// How long before the end the agent must stay in its new place, seconds.
const SETTLED_S: f64 = 0.5;
/// The smallest lateral overlap of the boxes at the end, meters.
const OVERLAP_M: f64 = 0.5;
/// The least gap at the end, meters.
const LEAST_GAP_M: f64 = 1.0;
/// The largest speed across, m/s.
const MOST_ACROSS_MPS: f64 = 1.2;
/// Who comes over settles as a spring does with this time, seconds: faster than |d| over it, it would overshoot. The
/// excess that costs ½, m/s.
const SETTLES_S: f64 = 0.8;
const OVERSHOOT_MPS: f64 = 0.1;
/// The longest time after which `before` reaches the place, seconds.
const MAX_DELAY_S: f64 = 3.0;
/// The share of the longest delay that is used.
const DELAY_SHARE: f64 = 0.9;

impl SceneObjective for CutIn {
    fn whose(&self) -> Whose {
        Whose::One("other")
    }

    fn others(&self) -> Vec<&AgentSelector> {
        vec![&self.before]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[GAP, RELATIVE_SPEED]
    }

    fn validate(&self) -> settings::Result {
        one_agent("before", &self.before)
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let n_timesteps = states.dim(2)?;
        let frame = PathFrame::between(states, context, &self.before, agents)?;
        let gap_m = &frame.gap_m;
        let excess_m = frame.beside_m.broadcast_sub(&frame.half_widths_m)?;
        let left_s = |t: usize| DELAY_SHARE * MAX_DELAY_S.min((n_timesteps - 1 - t) as f64 * context.dt_s);
        let left_s: Vec<f64> = (0..n_timesteps).map(left_s).collect();
        let left_s = Tensor::from_vec(left_s, n_timesteps, states.device())?.to_dtype(states.dtype())?;
        let reach_m = frame.owner_mps.broadcast_mul(&left_s)?;

        let wanted_m = context.wanted(GAP, ANY_GAP_M, states)?;
        let closing_mps = (&frame.owner_mps - &frame.agent_mps)?;
        let wanted_mps = context.wanted(RELATIVE_SPEED, ANY_SPEED_MPS, states)?;
        let parts = [
            penalty(&excess_m, LATERAL_TOLERANCE_M)?,
            penalty(&beyond(gap_m, &wanted_m)?, TOLERANCE_M)?,
            penalty(&(gap_m - reach_m)?.relu()?, TOLERANCE_M)?,
            penalty(&beyond(&closing_mps, &wanted_mps)?, TOLERANCE_MPS)?,
        ];
        let best = best_potential(&parts, &frame.counts)?;

        let n_settled = (SETTLED_S / context.dt_s).round().max(1.0) as usize;
        let n_settled = n_settled.min(n_timesteps.saturating_sub(context.n_history));
        if n_settled == 0 {
            return nothing(states);
        }
        let last = |tensor: &Tensor| tensor.narrow(1, n_timesteps - n_settled, n_settled);
        let last_but = |n: usize| frame.beside_m.narrow(1, n_timesteps - n_settled - n, n_settled);
        let outside_m = (last(&excess_m)? + OVERLAP_M)?.relu()?;
        let short_m = (LEAST_GAP_M - last(gap_m)?)?.relu()?;
        let comes_mps = ((last_but(1)? - last_but(0)?)? * (1.0 / context.dt_s))?;
        let overshoots_mps = (comes_mps - (last_but(0)? * (1.0 / SETTLES_S))?)?.relu()?;
        let unsettled = (penalty(&outside_m, LATERAL_TOLERANCE_M)? + penalty(&short_m, TOLERANCE_M)?)?;
        let unsettled = (unsettled + penalty(&overshoots_mps, OVERSHOOT_MPS)?)?;
        let counted = last(&frame.counts)?;
        let n_counted = (counted.sum(1)? + 1e-6)?;
        let unsettled = (unsettled * &counted)?.sum(1)?.div(&n_counted)?;

        (unsettled + best)? + unhurried(&frame.beside_m, &frame.counts, MOST_ACROSS_MPS, context.dt_s)?
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_of_match};
    use super::*;

    fn objective() -> CutIn {
        CutIn { before: ego() }
    }

    /// The other drives one lane to the left, level with the ego's front.
    fn beside() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (9.0, 3.5, 0.0, 8.0)])
    }

    #[test]
    fn gradients_match_for_the_other_and_nothing_pulls_at_the_ego() {
        let aiming = || beside().aiming_at(GAP, [6.0, 8.0]);
        for traffic in [aiming(), aiming().aiming_at(RELATIVE_SPEED, [1.0, 2.0])] {
            assert_gradients_of_match(&objective(), &traffic, |agent, _| agent == 1);
            let gradient = traffic.gradient(&objective());
            assert!(gradient[..gradient.len() / 2].iter().all(|g| *g == 0.0));
        }
    }

    #[test]
    fn following_the_gradient_moves_the_other_in_front_with_the_wanted_gap() {
        let beside = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (9.0, 3.0, 0.0, 8.0)]);
        let traffic = beside.aiming_at(GAP, [5.0, 6.0]);
        let states = &after_ascent(&objective(), &traffic, 600)[0];
        assert_eq!(states[0], traffic.states_vec()[0][0]);
        let last = traffic.generated().end - 1;
        assert!(states[1][last][1].abs() < 1.6, "{:?}", states[1][last]);
        // The boxes begin to share a path with the target gap.
        let is_met = |t: usize| {
            let gap_m = states[1][t][0] - states[0][t][0] - 4.5;
            (states[1][t][1].abs() - 1.8).abs() < 0.3 && (4.8..6.2).contains(&gap_m)
        };
        assert!(traffic.generated().any(is_met), "{:?}", states[1]);
    }

    #[test]
    fn the_relative_speed_is_that_of_the_moment() {
        // The other moves over at once, 2 m/s slower than the ego.
        let slower = || Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (14.0, 3.4, -0.1813, 6.1)]);
        let value = |range| slower().aiming_at(RELATIVE_SPEED, range).potential(&objective())[0];
        let (right, wrong) = (value([1.5, 2.5]), value([-2.5, -1.5]));
        assert!(right > -0.3, "{right}");
        // 3.5 tolerances off at each of nine moments: together between 6.1 / 9^(1/4) and 6.1.
        assert!((-6.2..-6.1 / 9f64.powf(0.25)).contains(&(wrong - right)), "{wrong}");
    }

    /// As `beside`, but the other is at these offsets.
    fn moving_over(offset_m: impl Fn(f64) -> f64) -> Traffic {
        let mut traffic = beside();
        let mut states: Vec<f64> = traffic.states.flatten_all().unwrap().to_vec1().unwrap();
        let dt_s = traffic.context.dt_s;
        for (t, state) in states[36..].chunks_exact_mut(3).enumerate() {
            state[1] = offset_m(t as f64 * dt_s);
        }
        let states = Tensor::from_vec(states, traffic.states.shape(), &candle_core::Device::Cpu).unwrap();
        traffic.states = candle_core::Var::from_tensor(&states).unwrap();
        traffic
    }

    #[test]
    fn a_cut_in_costs_little_and_what_is_none_costs_much() {
        let done = moving_over(|t_s| 3.4 - 1.25 * (t_s - 0.4).max(0.0));
        let (met, missed) = (done.potential(&objective())[0], beside().potential(&objective())[0]);
        assert!(met > -0.4 && missed < -2.0, "{met}, {missed}");
        // There is no cut-in from behind: the gap is negative at the same offset.
        let behind = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (-9.0, 1.0, 0.0, 8.0)]);
        assert!(behind.potential(&objective())[0] < -10.0);
    }

    #[test]
    fn who_comes_over_slows_down_aside_before_the_middle() {
        // Both come to 0.5 m from the middle, the first with 1.1 m/s: over the last three timesteps, whose offsets are
        // 0.94, 0.72 and 0.5 m, its excess over |d| / 0.8 s is 0, 1.1 - 0.9 and 1.1 - 0.625 m/s, in units of 0.1 m/s.
        let crosses = moving_over(|t_s| 0.5 + 1.1 * (2.2 - t_s)).potential(&objective())[0];
        let cost = 0.5 * (2.0_f64.powi(2) + 4.75_f64.powi(2)) / 3.0;
        assert!((crosses + cost).abs() < 0.2, "{crosses}, {cost}");
        // The other lets its offset fade with 0.8 s, from 0.92 m on.
        let fades = |t_s: f64| if t_s < 1.8 { 2.99 - 1.15 * t_s } else { 0.92 * ((1.8 - t_s) / 0.8).exp() };
        let rests = moving_over(fades).potential(&objective())[0];
        assert!(rests > -0.4, "{rests}");
    }

    #[test]
    fn a_bend_is_no_shift() {
        // Both on circles around (0, 50), the other 3.5 m further in and ahead: across the ego's path it does not move.
        let arc = |radius_m: f64, ahead_m: f64, t: usize| {
            let angle = (1.6 * t as f64 + ahead_m) / 50.0;
            [radius_m * angle.sin(), 50.0 - radius_m * angle.cos(), angle]
        };
        let mut traffic = beside();
        let states: Vec<f64> =
            (0..12).flat_map(|t| arc(50.0, 0.0, t)).chain((0..12).flat_map(|t| arc(46.5, 10.0, t))).collect();
        let states = Tensor::from_vec(states, traffic.states.shape(), &candle_core::Device::Cpu).unwrap();
        traffic.states = candle_core::Var::from_tensor(&states).unwrap();
        let (bend, straight) = (traffic.potential(&objective())[0], beside().potential(&objective())[0]);
        // The path continues straight after its owner's last state, which adds 10² / (2 · 50) = 1 m there, at 1.6 m/s.
        assert!((bend - straight).abs() < 0.6 * straight.abs(), "{bend}, {straight}");
    }

    #[test]
    fn the_target_gap_decides_and_other_parameters_do_not() {
        let value = |traffic: Traffic| traffic.potential(&objective())[0];
        assert_eq!(value(beside()), value(beside().aiming_at(GAP, ANY_GAP_M).aiming_at("side", [0.0, 1.0])));
        assert!(value(beside().aiming_at(GAP, [11.0, 12.0])) < value(beside()) - 1.0);
    }
}
