//! Bring two agents close to a collision.

use super::approach::Approach;
use super::motion::{best_moment, nothing};
use super::{AgentSelector, SceneContext, SceneObjective, default_weight, ego, one};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Bring two agents to the brink of a collision: at some time their time to collision is below `ttc_s`.
///
/// With d(t) and u(t) their relative position and velocity, s(t) the separation of their boxes (see `no_collision`), the
/// inverse time to collision is q = -(d · u / ‖d‖) / (max(s, 0) + ½ m), and the distance at which the centers would pass
/// each other, both going straight on, is m = ‖d × u‖ / ‖u‖. The cost of a moment is
///
/// c(t) = ½ (max(1 / ttc - q, 0) / τ_q)² + ½ (max(m - w, 0) / τ_m)²,
///
/// w half the widths of both: closing too slowly, and passing beside each other. The best moment decides, smoothly:
/// J = -(Σ (c(t) + δ)⁻⁴)^(-1/4) over time with δ = 0.01, summed over the pairs of one agent of `agents` and another of `to`.
/// Whether the two collide is another matter: add `no_collision` for near misses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AdversarialTtc {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// One of the two: `ego` or a role (or `all`: every pair comes close).
    #[serde(default = "ego")]
    pub agents: AgentSelector,
    /// The other of the two.
    pub to: AgentSelector,
    /// The time to collision to fall below, seconds.
    #[serde(default = "default_ttc_s")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub ttc_s: f64,
    /// The shortfall τ_q of inverse time to collision that costs ½, 1/s.
    #[serde(default = "default_tolerance_per_s")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_per_s: f64,
    /// The distance τ_m of passing that costs ½, meters.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
}

const fn default_ttc_s() -> f64 {
    1.5
}

const fn default_tolerance_per_s() -> f64 {
    0.2
}

impl SceneObjective for AdversarialTtc {
    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.to]
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let Some((pairs, _, approach)) = Approach::between(states, context, [&self.agents, &self.to])? else {
            return nothing(states);
        };
        let slow = ((1.0 / self.ttc_s - approach.inverse_ttc_per_s)?.relu()? * (1.0 / self.tolerance_per_s))?;
        let aside = (approach.aside_m * (1.0 / self.tolerance_m))?;
        let cost = ((slow.sqr()? + aside.sqr()?)? * 0.5)?;
        pairs.sum_over_rows(&best_moment(&cost, &approach.counts)?.neg()?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match};
    use super::*;

    fn objective() -> AdversarialTtc {
        AdversarialTtc {
            weight: 1.0,
            agents: AgentSelector::new("ego"),
            to: AgentSelector::new("other"),
            ttc_s: 1.0,
            tolerance_per_s: 0.2,
            tolerance_m: 1.0,
        }
    }

    /// The least time to collision of agents 0 and 1, both driving along x on one line, from the lengths of their boxes.
    fn least_ttc_s(states: &[Vec<Vec<f64>>], dt_s: f64) -> f64 {
        let moment = |t: usize| {
            let gap_m = |t: usize| states[1][t][0] - states[0][t][0] - 4.5;
            let closing_mps = (gap_m(t - 1) - gap_m(t)) / dt_s;
            if closing_mps > 0.0 { gap_m(t).max(0.0) / closing_mps } else { f64::INFINITY }
        };
        (1..states[0].len()).map(moment).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn gradients_match_and_the_time_to_collision_falls() {
        let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (16.0, 0.0, 0.0, 7.0), (30.0, 4.0, 0.3, 7.0)]);
        assert_gradients_match(&objective(), &traffic);
        assert!(least_ttc_s(&traffic.states_vec()[0], traffic.context.dt_s) > 5.0);
        let states = after_ascent(&objective(), &traffic, 300);
        let least_s = least_ttc_s(&states[0], traffic.context.dt_s);
        assert!(least_s < 1.3, "{least_s}");
        // Crossing traffic that would pass at a distance has gradients in all of its states, too.
        let crossing = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (18.0, -15.0, 1.4, 7.0)]);
        assert_gradients_match(&objective(), &crossing);
    }

    #[test]
    fn who_is_about_to_collide_costs_little_and_who_passes_beside_costs_much() {
        // 9 m behind, 10 m/s faster, until the boxes touch: less than 1 s to a collision from the beginning.
        let near = Traffic::straight(&[(0.0, 0.0, 0.0, 11.0), (13.0, 0.0, 0.0, 1.0)]).potential(&objective())[0];
        let beside = Traffic::straight(&[(0.0, 0.0, 0.0, 11.0), (13.0, 8.0, 0.0, 1.0)]).potential(&objective())[0];
        // Nothing but δ; and, for moments of equal cost (8 - 1.8)² / 2, that cost divided by the fourth root of their number.
        assert!(near > -0.02 && near <= 0.0, "{near}");
        let most = 0.5 * 6.2f64.powi(2);
        assert!(beside > -most && beside < -most / 12f64.powf(0.25) * 0.95, "{beside}, expected almost {most}");
    }
}
