//! Avoid collisions.

use super::box_separation::separation_m;
use super::motion::{nothing, penalty};
use super::pairs::{PairQuery, Pairs, Reach};
use super::{AgentSelector, SceneContext, SceneObjective};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Do not drive into each other: J = -½ Σ ∫ (max(m - s(t), 0) / τ)² dt over pairs of a chosen agent and any other.
///
/// s is the separation of the two boxes by the separating-axis theorem, made smooth: positive where they are apart,
/// negative where they overlap. For a pair that is closer than m at present, m is its separation there: who stands in a
/// queue or beside another is not pushed away, and some recorded boxes overlap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoCollision {
    /// Two agents that may touch each other, if any.
    #[serde(skip)]
    pub except: Option<[AgentSelector; 2]>,
    /// The separation m below which a pair has a cost, meters.
    #[serde(default = "default_margin_m")]
    #[schemars(range(min = 0.0))]
    pub margin_m: f64,
}

/// The lack of separation τ that costs ½ a second, meters.
const TOLERANCE_M: f64 = 0.5;

const fn default_margin_m() -> f64 {
    0.5
}

impl SceneObjective for NoCollision {
    fn others(&self) -> Vec<&AgentSelector> {
        self.except.iter().flatten().collect()
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        // Two of the axes are perpendicular: the separation is at least d / √2 less the radii of both boxes and the
        // smoothing, for centers d apart. Pairs beyond that cost nothing.
        let reach = Reach { per_radius: 2f64.sqrt(), beyond_m: 2f64.sqrt() * (self.margin_m + SMOOTHING_M) };
        let query = PairQuery {
            one: agents,
            other: &AgentSelector::default(),
            reach: Some(reach),
            except: self.except.as_ref(),
        };
        let Some(pairs) = Pairs::gather(states, context, &query)? else { return nothing(states) };
        let separation_m = separation_m(&pairs)?;
        let present = context.n_history.saturating_sub(1);
        let at_present = |tensor: &Tensor| tensor.narrow(1, present, 1);
        let closer_m = ((self.margin_m - at_present(&separation_m)?)?.relu()? * at_present(&pairs.both_valid)?)?;
        let lack_m = (self.margin_m - separation_m)?.broadcast_sub(&closer_m)?;
        let values = penalty(&lack_m.relu()?, TOLERANCE_M)?;
        pairs.sum_over_rows(&((values * &pairs.counts)?.sum(1)? * context.dt_s)?)
    }
}

/// More than smoothing subtracts from a separation, meters.
const SMOOTHING_M: f64 = 0.25;

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, footprint};
    use super::*;

    fn objective() -> NoCollision {
        NoCollision { except: None, margin_m: 0.5 }
    }

    /// A fast car behind a slow one, and another that crosses.
    fn traffic() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 10.0), (8.0, 0.3, 0.05, 2.0), (9.0, -9.0, 1.6, 6.0)])
    }

    fn n_overlaps(states: &[Vec<Vec<f64>>]) -> usize {
        let pairs = [(0, 1), (0, 2), (1, 2)];
        let overlaps = |t: usize| {
            pairs.iter().filter(|(a, b)| footprint(states, *a, t).overlaps(&footprint(states, *b, t))).count()
        };
        (0..states[0].len()).map(overlaps).sum()
    }

    #[test]
    fn gradients_match_and_keep_boxes_apart() {
        let traffic = traffic();
        assert_gradients_match(&objective(), &traffic);
        assert!(n_overlaps(&traffic.states_vec()[0]) > 2);
        assert_eq!(n_overlaps(&after_ascent(&objective(), &traffic, 200)[0]), 0);
    }

    #[test]
    fn pairs_far_apart_or_as_close_as_at_present_cost_nothing() {
        assert_eq!(Traffic::straight(&[(0.0, 0.0, 0.0, 10.0), (60.0, 0.0, 0.0, 10.0)]).potential(&objective()), [0.0]);
        // In a queue, side by side with little between them, and boxes that overlap.
        for (x, y, speed_mps) in [(4.8, 0.0, 0.0), (0.3, 2.0, 10.0), (1.0, 0.5, 0.0)] {
            let close = Traffic::straight(&[(0.0, 0.0, 0.0, speed_mps), (x, y, 0.0, speed_mps)]);
            assert!(close.potential(&objective())[0].abs() < 1e-9, "{x} {y}");
        }
        let closing = Traffic::straight(&[(0.0, 0.0, 0.0, 1.0), (4.8, 0.0, 0.0, 0.0)]);
        assert!(closing.potential(&objective())[0] < -0.1);
    }

    #[test]
    fn the_filter_by_distance_changes_nothing() {
        // With a vast tolerance for the filter, the potential is the same.
        let objective = objective();
        for x in [4.0, 6.0, 7.0, 8.0] {
            let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 3.0), (x, 4.0, 0.7, 0.0)]);
            let all = AgentSelector::default();
            let query = PairQuery::of(&all, &all);
            let pairs = Pairs::gather(traffic.states.as_tensor(), &traffic.context, &query);
            let pairs = pairs.unwrap().unwrap();
            let separation_m = separation_m(&pairs).unwrap();
            let at_present = separation_m.narrow(1, traffic.context.n_history - 1, 1).unwrap();
            let margin_m = at_present.minimum(objective.margin_m).unwrap();
            let lack_m = margin_m.broadcast_sub(&separation_m).unwrap().relu().unwrap();
            let cost = (penalty(&lack_m, TOLERANCE_M).unwrap() * &pairs.counts).unwrap();
            let all = cost.sum_all().unwrap().to_scalar::<f64>().unwrap() * traffic.context.dt_s;
            assert!((traffic.potential(&objective)[0] - all).abs() < 1e-12);
        }
    }

    #[test]
    fn the_excepted_pair_may_touch_and_no_other() {
        // Two that overlap at the end, and a third that drives into the first.
        let crash = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (18.0, 0.0, 0.0, 0.0), (0.0, 2.2, -0.05, 8.0)]);
        let except = |names: [&str; 2]| NoCollision { except: Some(names.map(AgentSelector::new)), ..objective() };
        let all = crash.potential(&objective())[0];
        let others = crash.potential(&except(["ego", "other"]))[0];
        assert!(all < others && others < 0.0, "{all} {others}");
        assert_eq!(others, crash.potential(&except(["other", "ego"]))[0]);
    }
}
