//! Barely avoid each other.

use super::approach::Approach;
use super::box_separation::separation_m;
use super::motion::{best_moment, nothing, penalty};
use super::pairs::{PairQuery, Pairs};
use super::{AgentSelector, SceneContext, SceneObjective, beyond, default_weight, interval, one_agent};
use crate::settings;
use candle_core::{DType, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Come shortly before a collision, and avoid it.
///
/// With q(t) the inverse time to collision, a(t) how far beside each other the two would pass, both going straight on, and s(t) the separation
/// of their boxes (`adversarial_ttc`, `no_collision`), a moment costs c = ½ (\[q\] / τ_q)² + ½ (a / τ_m)², where \[·\] is the distance to
/// the inverse of the wanted times. The best moment decides, smoothly:
///
/// J = -(Σ (c + δ)⁻⁴)^(-1/4) - ∫ ½ (max(margin - s, 0) / τ_s)² + ½ (max(q - q_most, 0) / τ_q)² exp(-½ (a / τ_m)²) dt
///
/// with δ = 0.01 and τ_s = 0.3 m: never touching, and never nearer to a collision than wanted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NearMiss {
    /// How much this objective counts beside others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// One of the two: `ego` or a role.
    #[serde(default = "first")]
    pub agents: AgentSelector,
    /// The other of the two.
    #[serde(default = "second")]
    pub to: AgentSelector,
    /// The least time to collision, least and most, seconds. Left out: that of the bucket that a request asks for (`min_ttc_s`), else 0.6 to
    /// 1.3.
    #[serde(default)]
    pub ttc_s: Option<[f64; 2]>,
    /// How far apart the boxes stay, at least, meters.
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

fn first() -> AgentSelector {
    AgentSelector::new("first")
}

fn second() -> AgentSelector {
    AgentSelector::new("second")
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

/// The parameter at which it aims, as the events report it.
const MIN_TTC: &str = "min_ttc_s";
/// The time to collision where none is asked for, seconds.
const ANY_TTC_S: [f64; 2] = [0.6, 1.3];
/// Shorter times to collision are as good as a collision, seconds.
const LEAST_TTC_S: f64 = 0.1;
/// The lack of separation τ_s that costs ½ a second, meters.
const SEPARATION_TOLERANCE_M: f64 = 0.3;

impl SceneObjective for NearMiss {
    fn kind(&self) -> &'static str {
        "near_miss"
    }

    fn weight(&self) -> f64 {
        self.weight
    }

    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.to]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[MIN_TTC]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        one_agent("to", &self.to)?;
        interval("ttc_s", self.ttc_s)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let query = PairQuery { one: &self.agents, other: &self.to, reach: None };
        let Some(pairs) = Pairs::gather(states, context, &query)?.filter(|_| states.dim(2).is_ok_and(|n| n > 1)) else {
            return nothing(states);
        };
        let separation_m = separation_m(&pairs)?;
        let approach = Approach::new(&pairs, &separation_m, context.dt_s)?;
        // The interval of inverse times: the longest time is the least of them.
        let wanted_s =
            context.wanted(MIN_TTC, self.ttc_s, ANY_TTC_S, states)?.to_dtype(DType::F64)?.to_vec2::<f64>()?;
        let inverse =
            wanted_s.iter().flat_map(|ttc_s| [1.0 / ttc_s[1].max(LEAST_TTC_S), 1.0 / ttc_s[0].max(LEAST_TTC_S)]);
        let inverse = Tensor::from_vec(inverse.collect::<Vec<_>>(), (wanted_s.len(), 2), states.device())?;
        let wanted = pairs.of_rows(&inverse.to_dtype(states.dtype())?)?;
        let q = &approach.inverse_ttc_per_s;
        let aside = penalty(&approach.aside_m, self.tolerance_m)?;
        let cost = (penalty(&beyond(q, &wanted)?, self.tolerance_per_s)? + &aside)?.neg()?;
        let best = best_moment(&cost, &approach.counts)?.neg()?;
        let nearer = q.broadcast_sub(&wanted.narrow(1, 1, 1)?)?.relu()?;
        let nearer = ((penalty(&nearer, self.tolerance_per_s)? * aside.exp()?)? * &approach.counts)?.sum(1)?;
        let lack_m = (self.margin_m - separation_m)?.relu()?;
        let touching = (penalty(&lack_m, SEPARATION_TOLERANCE_M)? * &pairs.counts)?.sum(1)?;
        pairs.sum_over_rows(&(best + ((nearer + touching)? * context.dt_s)?)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match};
    use super::*;
    use crate::geometry::{OrientedBox, Vec2};

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
        }
    }

    #[test]
    fn the_time_to_collision_falls_into_the_interval_and_nobody_touches() {
        let states = &after_ascent(&objective(Some([0.8, 1.2])), &behind(), 400)[0];
        let gap_m = |t: usize| states[1][t][0] - states[0][t][0] - 4.5;
        let ttc_s = |t: usize| {
            let closing_mps = (gap_m(t - 1) - gap_m(t)) / 0.2;
            if closing_mps > 0.1 { gap_m(t) / closing_mps } else { f64::INFINITY }
        };
        let least_s = (4..states[0].len()).map(ttc_s).fold(f64::INFINITY, f64::min);
        assert!((0.55..1.35).contains(&least_s), "{least_s}");
        let footprint = |agent: usize, t: usize| {
            let [x, y, heading_rad] = states[agent][t][..] else { unreachable!() };
            OrientedBox { center: Vec2::new(x, y), heading_rad, length_m: 4.5, width_m: 1.8 }
        };
        assert!((0..states[0].len()).all(|t| !footprint(0, t).overlaps(&footprint(1, t))));
    }

    #[test]
    fn who_is_too_near_to_a_collision_costs_more_than_who_is_as_near_as_wanted() {
        // Bumper to bumper 16 m apart at the first timestep and closing with 8 m/s for 2.2 s would be a collision; with 5 m/s the gap ends
        // at 5 m and the time to collision, with the half meter that is added, at (5 + 0.5) / 5 s = 1.1 s.
        let at = |closing_mps: f64| Traffic::straight(&[(0.0, 0.0, 0.0, 9.0), (20.5, 0.0, 0.0, 9.0 - closing_mps)]);
        let value = |closing_mps: f64| at(closing_mps).potential(&objective(Some([0.8, 1.2])))[0];
        assert!(value(5.0) > -0.05, "{}", value(5.0));
        assert!(value(8.0) < -2.0 && value(2.0) < -2.0, "{} {}", value(8.0), value(2.0));
        // A request's bucket stands in where nothing is configured.
        let mut asked = at(5.0);
        asked.context.targets[0] = [(MIN_TTC.to_owned(), [0.8, 1.2])].into();
        assert_eq!(asked.potential(&objective(None))[0], value(5.0));
    }
}
