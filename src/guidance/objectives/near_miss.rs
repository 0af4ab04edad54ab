//! Barely avoid each other.

use super::approach::Approach;
use super::encroachment::Encroachment;
use super::motion::{best_moment, nothing, penalty};
use super::{AgentSelector, SceneContext, SceneObjective, beyond, default_weight, first, interval, one_agent, second};
use crate::guidance::Target;
use crate::settings;
use candle_core::{DType, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Come to the brink of a collision and avoid it, or cross a place shortly after the other.
///
/// With q(t) the inverse time to collision, b(t) the deceleration that avoids it (DRAC), a(t) how far beside each other the two would pass, both
/// going straight on, w(t) how far beside their courses they come in the next 0.8 s, and s(t) the separation of their boxes (`adversarial_ttc`, `no_collision`), a moment on a course to collide costs
/// c = ½ (\[q\] / τ_q)² + ½ (\[b_least - b\]₊ / τ_b)² + ½ (a / τ_m)² + ½ (w / 0.5 m)², where \[·\] is the distance to the inverse of the wanted times; what two
/// moments of crossing cost says [`Encroachment`]. The best decides, smoothly:
///
/// J = -(Σ (c + δ)⁻⁴)^(-1/4) - ∫ ½ (max(margin - s, 0) / τ_s)² + ½ (max(q - q_most, 0) / τ_q)² exp(-½ (a / τ_m)²) dt
///
/// with δ = 0.01, τ_s = 0.3 m and τ_b = 1 m/s²: never touching, and never nearer to a collision than wanted. A course to collide counts from
/// 0.6 s after the present on, and where the collision would come before the last state. Where a time to collision is asked for, crossing does
/// not count, and the other way round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NearMiss {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// One of the two: `ego` or a role.
    #[serde(default = "first")]
    pub agents: AgentSelector,
    /// The other of the two.
    #[serde(default = "second")]
    pub to: AgentSelector,
    /// The range of the smallest time to collision, seconds. Left out: that of the target (`min_ttc_s`), else 0.6 to
    /// 1.3.
    #[serde(default)]
    pub ttc_s: Option<[f64; 2]>,
    /// The smallest deceleration by which one of the two avoids that collision (DRAC), m/s².
    #[serde(default = "default_drac_mps2")]
    #[schemars(range(min = 0.0, max = 20.0))]
    pub drac_mps2: f64,
    /// The range of the time between one and the other covering the same place, seconds. Left out: that of the target
    /// (`pet_s`), else 0.2 to 0.4.
    #[serde(default)]
    pub pet_s: Option<[f64; 2]>,
    /// The smallest gap between the boxes, meters.
    #[serde(default = "default_margin_m")]
    #[schemars(range(min = 0.0, max = 10.0))]
    pub margin_m: f64,
    /// The error τ_q of the inverse time to collision that costs ½, 1/s.
    #[serde(default = "default_tolerance_per_s")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_per_s: f64,
    /// The distance τ_m of passing that costs ½, meters.
    #[serde(default = "default_tolerance_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
}

const fn default_drac_mps2() -> f64 {
    4.0
}

const fn default_margin_m() -> f64 {
    0.4
}

const fn default_tolerance_per_s() -> f64 {
    0.2
}

const fn default_tolerance_m() -> f64 {
    0.5
}

/// The parameters at which it aims, as the events report them.
const MIN_TTC: &str = "min_ttc_s";
const PET: &str = "pet_s";
/// The time to collision without a target, seconds.
const ANY_TTC_S: [f64; 2] = [0.6, 1.3];
/// The post-encroachment time without a target, seconds.
const ANY_PET_S: [f64; 2] = [0.2, 0.4];
/// The lack of deceleration τ_b that costs ½, m/s².
const DRAC_TOLERANCE_MPS2: f64 = 1.0;
/// The way beside one's course that costs ½, meters: who drives around a bend is on no course to collide with those beyond it.
const SWERVE_TOLERANCE_M: f64 = 0.5;
/// How long after the present a collision may threaten at the soonest, seconds.
const SOONEST_S: f64 = 0.6;
/// Shorter times to collision count as a collision, seconds.
const LEAST_TTC_S: f64 = 0.1;
/// The lack of separation τ_s that costs ½ a second, meters.
const SEPARATION_TOLERANCE_M: f64 = 0.3;

impl SceneObjective for NearMiss {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.to]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[MIN_TTC, PET]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        one_agent("to", &self.to)?;
        interval("ttc_s", self.ttc_s)?;
        interval("pet_s", self.pet_s)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let Some((pairs, separation_m, approach)) = Approach::between(states, context, [&self.agents, &self.to])?
        else {
            return nothing(states);
        };
        // The interval of inverse times: the longest time is the least of them.
        let wanted_s =
            context.wanted(MIN_TTC, self.ttc_s, ANY_TTC_S, states)?.to_dtype(DType::F64)?.to_vec2::<f64>()?;
        let inverse =
            wanted_s.iter().flat_map(|ttc_s| [1.0 / ttc_s[1].max(LEAST_TTC_S), 1.0 / ttc_s[0].max(LEAST_TTC_S)]);
        let inverse = Tensor::from_vec(inverse.collect::<Vec<_>>(), (wanted_s.len(), 2), states.device())?;
        let wanted = pairs.of_rows(&inverse.to_dtype(states.dtype())?)?;
        let q = &approach.inverse_ttc_per_s;
        let aside = penalty(&approach.aside_m, self.tolerance_m)?;
        let drac_mps2 = ((q * &approach.relative_mps)? * 0.5)?;
        let gentle = penalty(&(self.drac_mps2 - drac_mps2)?.relu()?, DRAC_TOLERANCE_MPS2)?;
        let bends = penalty(&approach.swerve_m, SWERVE_TOLERANCE_M)?;
        let cost = ((penalty(&beyond(q, &wanted)?, self.tolerance_per_s)? + &aside)? + (gentle + bends)?)?.neg()?;
        let in_time = in_time(&wanted_s, context, &approach.counts)?;
        let counts = (&approach.counts * pairs.of_rows(&in_time)?)?;
        let conflict = best_moment(&cost, &counts)?;
        let pet_s = pairs.of_rows(&context.wanted(PET, self.pet_s, ANY_PET_S, states)?)?;
        let orders = [[&pairs.first, &pairs.second], [&pairs.second, &pairs.first]];
        let best = match Encroachment::new(&orders, &pet_s, context.dt_s)? {
            None => conflict,
            Some(crossing) => {
                let either = Tensor::stack(&[conflict, best_moment(&crossing.costs, &crossing.counts)?], 1)?;
                let can_be = Tensor::stack(&[counts.max(1)?, crossing.counts.max(1)?], 1)?;
                best_moment(&either, &(pairs.of_rows(&self.meant(context, states)?)? * can_be)?)?
            }
        };
        let best = best.neg()?;
        let nearer = q.broadcast_sub(&wanted.narrow(1, 1, 1)?)?.relu()?;
        let nearer = ((penalty(&nearer, self.tolerance_per_s)? * aside.exp()?)? * &approach.counts)?.sum(1)?;
        let lack_m = (self.margin_m - separation_m)?.relu()?;
        let touching = (penalty(&lack_m, SEPARATION_TOLERANCE_M)? * &pairs.counts)?.sum(1)?;
        pairs.sum_over_rows(&(best + ((nearer + touching)? * context.dt_s)?)?)
    }
}

impl NearMiss {
    /// 1 for each kind of near miss (collision course, crossing) that a row may show, (B, 2): both, unless the target
    /// names one.
    fn meant(&self, context: &SceneContext, like: &Tensor) -> Result<Tensor> {
        let asks = |target: &Target, name: &str, configured: Option<[f64; 2]>| {
            configured.is_some() || target.contains_key(name)
        };
        let meant: Vec<f64> = context
            .targets
            .iter()
            .flat_map(|target| match (asks(target, MIN_TTC, self.ttc_s), asks(target, PET, self.pet_s)) {
                (true, false) => [1.0, 0.0],
                (false, true) => [0.0, 1.0],
                _ => [1.0, 1.0],
            })
            .collect();
        Tensor::from_vec(meant, (context.targets.len(), 2), like.device())?.to_dtype(like.dtype())
    }
}

/// 1 at the moments at which a collision may threaten each row within its times `wanted_s`, (B, T - 1) for `like` (P, T
/// - 1). Earlier moments would need a jerk, and whether a collision follows the last state is not known.
fn in_time(wanted_s: &[Vec<f64>], context: &SceneContext, like: &Tensor) -> Result<Tensor> {
    let n_steps = like.dim(1)?;
    let first = context.n_history as f64 + SOONEST_S / context.dt_s - 1.0;
    let moments = wanted_s.iter().flat_map(|ttc_s| {
        let end = (n_steps as f64 - ttc_s[0].max(LEAST_TTC_S) / context.dt_s).ceil();
        (0..n_steps).map(move |t| f64::from(u8::from((t as f64) < end && t as f64 >= first - 1e-6)))
    });
    Tensor::from_vec(moments.collect::<Vec<_>>(), (wanted_s.len(), n_steps), like.device())?.to_dtype(like.dtype())
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, footprint};
    use super::*;

    fn objective(ttc_s: Option<[f64; 2]>) -> NearMiss {
        let defaults: NearMiss = toml::from_str("agents = 'ego'\nto = 'other'").expect("everything else has a default");
        NearMiss { ttc_s, ..defaults }
    }

    /// A car behind another in its lane; one that crosses.
    fn behind() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (16.0, 0.0, 0.0, 7.0)])
    }

    fn crossing() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (18.0, -15.0, 1.4, 7.0)])
    }

    #[test]
    fn gradients_match() {
        for traffic in [behind(), crossing(), Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (7.0, 0.2, 0.1, 1.0)])] {
            assert_gradients_match(&objective(Some([0.8, 1.2])), &traffic);
            assert_gradients_match(&objective(None), &traffic);
            assert_gradients_match(&NearMiss { pet_s: Some([0.3, 0.7]), ..objective(None) }, &traffic);
        }
    }

    #[test]
    fn the_time_to_collision_falls_into_the_interval_and_nobody_touches() {
        let states = &after_ascent(&objective(Some([0.8, 1.2])), &behind(), 400)[0];
        let gap_m = |t: usize| footprint(states, 0, t).distance(&footprint(states, 1, t));
        let closing_mps = |t: usize| (gap_m(t - 1) - gap_m(t)) / 0.2;
        let is_near_miss = |t: usize| {
            let (ttc_s, drac_mps2) = (gap_m(t) / closing_mps(t), closing_mps(t).powi(2) / (2.0 * gap_m(t)));
            (0.6..1.3).contains(&ttc_s) && drac_mps2 > 3.4
        };
        assert!((4..states[0].len()).any(is_near_miss), "{:?}", (0..states[0].len()).map(gap_m).collect::<Vec<_>>());
        assert!((0..states[0].len()).all(|t| !footprint(states, 0, t).overlaps(&footprint(states, 1, t))));
    }

    #[test]
    fn a_collision_that_is_easily_avoided_costs() {
        // Closing with 1 m/s, a time to collision of 1 s ends with a brake of 0.5 m/s².
        let creeping = Traffic::straight(&[(0.0, 0.0, 0.0, 3.0), (7.7, 0.0, 0.0, 2.0)]);
        let value = |drac_mps2: f64| creeping.potential(&NearMiss { drac_mps2, ..objective(Some([0.8, 2.0])) })[0];
        assert!(value(0.0) > -0.1 && value(4.0) < value(0.0) - 3.0, "{} {}", value(0.0), value(4.0));
    }

    #[test]
    fn one_crosses_shortly_after_the_other_and_nobody_touches() {
        let crosses = NearMiss { pet_s: Some([0.3, 0.7]), ..objective(None) };
        let states = &after_ascent(&crosses, &crossing(), 400)[0];
        let overlap = |t: usize, u: usize| footprint(states, 0, t).overlaps(&footprint(states, 1, u));
        let times = || 0..states[0].len();
        assert!(times().all(|t| !overlap(t, t)));
        let delays = times().flat_map(|t| times().map(move |u| (t, u))).filter(|(t, u)| overlap(*t, *u));
        // 0.4 and 0.6 s are the wanted times that the timesteps allow; who is well inside the other's place then still touches it a little
        // sooner.
        let least = delays.map(|(t, u)| t.abs_diff(u)).min();
        assert!(matches!(least, Some(1..=3)), "{least:?}");
    }

    #[test]
    fn who_is_too_near_to_a_collision_costs_more_than_who_is_as_near_as_wanted() {
        // Bumper to bumper 21.5 m apart at the first timestep, and closing with 8.8 m/s for 2.2 s, they end 2.1 m apart, after a time to collision
        // of 0.5 s that takes 8.8 / (2 · 0.5 s) = 9 m/s² to avoid. With 12 m/s they collide, with 4 m/s they are more than 3 s from it.
        let at = |closing_mps: f64| Traffic::straight(&[(0.0, 0.0, 0.0, 15.0), (26.0, 0.0, 0.0, 15.0 - closing_mps)]);
        let value = |closing_mps: f64| at(closing_mps).potential(&objective(Some([0.2, 1.2])))[0];
        assert!(value(8.8) > -0.1, "{}", value(8.8));
        assert!(value(12.0) < -1.0 && value(4.0) < -1.0, "{} {}", value(12.0), value(4.0));
        // A request's bucket stands in where nothing is configured.
        let mut asked = at(8.8);
        asked.context.targets[0] = [(MIN_TTC.to_owned(), [0.2, 1.2])].into();
        assert_eq!(asked.potential(&objective(None))[0], value(8.8));
    }
}
