//! Keep a distance that is neither too small nor too large.

use super::motion::{norm, nothing, penalty, positions};
use super::pairs::{PairQuery, Pairs, Reach};
use super::{AgentSelector, SceneContext, SceneObjective};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Keep a distance: J = -½ Σ ∫ { (max(d_min - d(t), 0) / τ)² + (max(d(t) - d_max, 0) / τ)² } dt over the pairs of one
/// agent of `agents` and another of `to`.
///
/// d is the distance of the centers, rounded by 0.05 m at zero. Without `max_m` there is no upper bound.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KeepDistance {
    /// The agents to keep it from: `all`, `ego` or a role.
    #[serde(default)]
    pub to: AgentSelector,
    /// The smallest distance d_min of the centers, meters.
    #[schemars(range(min = 0.0))]
    pub min_m: f64,
    /// The largest distance d_max of the centers, meters. Left out: no limit.
    #[serde(default)]
    #[schemars(range(min = 0.0))]
    pub max_m: Option<f64>,
}

/// The deviation τ that costs ½ a second, meters.
const TOLERANCE_M: f64 = 1.0;

impl SceneObjective for KeepDistance {
    fn others(&self) -> Vec<&AgentSelector> {
        vec![&self.to]
    }

    fn validate(&self) -> settings::Result {
        settings::ascending(("min_m", self.min_m), ("max_m", self.max_m.unwrap_or(f64::INFINITY)))
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let reach = Reach { per_radius: 0.0, beyond_m: self.min_m + 1.0 };
        let reach = self.max_m.is_none().then_some(reach);
        let query = PairQuery { reach, ..PairQuery::of(agents, &self.to) };
        let Some(pairs) = Pairs::gather(states, context, &query)? else { return nothing(states) };
        let distance_m = norm(&(positions(&pairs.second.states)? - positions(&pairs.first.states)?)?)?;
        let mut values = penalty(&(self.min_m - &distance_m)?.relu()?, TOLERANCE_M)?;
        if let Some(max_m) = self.max_m {
            values = (values + penalty(&(distance_m - max_m)?.relu()?, TOLERANCE_M)?)?;
        }
        pairs.sum_over_rows(&((values * &pairs.counts)?.sum(1)? * context.dt_s)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Of, Traffic, after_ascent, assert_gradients_match};
    use super::*;

    fn objective() -> Of<Box<KeepDistance>> {
        Of("other", Box::new(KeepDistance { to: AgentSelector::new("ego"), min_m: 8.0, max_m: Some(12.0) }))
    }

    #[test]
    fn gradients_match_and_distances_come_into_range() {
        for x in [3.0, 20.0] {
            let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (x, 1.0, 0.1, 8.0), (1.0, 5.0, 0.0, 8.0)]);
            assert_gradients_match(&objective(), &traffic);
            let before = traffic.states_vec();
            let states = after_ascent(&objective(), &traffic, 200);
            for t in traffic.generated() {
                let (a, b) = (&states[0][0][t], &states[0][1][t]);
                let distance_m = (a[0] - b[0]).hypot(a[1] - b[1]);
                assert!((7.8..12.2).contains(&distance_m), "{distance_m} at {t}, beginning with {x} m");
            }
            assert_eq!(states[0][2], before[0][2], "the third agent was not asked");
        }
    }

    #[test]
    fn the_cost_of_a_known_distance() {
        // 3 m too near over all generated timesteps.
        let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (5.0, 0.0, 0.0, 8.0)]);
        let expected = -0.5 * 9.0 * traffic.n_generated() as f64 * traffic.context.dt_s;
        let value = traffic.potential(&objective())[0];
        assert!((value / expected - 1.0).abs() < 0.05, "{value}, expected {expected}");
    }
}
