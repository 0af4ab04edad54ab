//! Cross the way of another shortly before it gets there.

use super::box_separation::separation_between_m;
use super::encroachment::Encroachment;
use super::motion::{best_moment, nothing, penalty};
use super::pairs::{self, Agents};
use super::{AgentSelector, SceneContext, SceneObjective, Whose, one_agent, second};
use crate::settings;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Cross a place shortly before `to` does, as in a left turn across oncoming traffic or where the right of way is
/// taken.
///
/// `Encroachment` defines the cost of two moments, one of `agents` and a later one of `to`; pairs count that are a
/// target post-encroachment time (`pet_s`) apart, 0.6 to 1.4 s if there is no target. With s(t) the separation of the
/// boxes (`no_collision`), the best decides, smoothly:
///
/// J = -(Σ (c + δ)⁻⁴)^(-1/4) - ∫ ½ (max(margin - s, 0) / τ_s)² dt
///
/// with δ = 0.01 and τ_s = 0.3 m. 0 where no two timesteps are so far apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CrossAhead {
    /// The agent that comes later: `ego` or a role.
    #[serde(default = "second")]
    pub to: AgentSelector,
}

/// The smallest gap between the boxes, meters.
const MARGIN_M: f64 = 0.4;

/// The parameter at which it aims, as the events report it.
const PET: &str = "pet_s";
/// The post-encroachment time without a target, seconds.
const ANY_PET_S: [f64; 2] = [0.6, 1.4];
/// The lack of separation τ_s that costs ½ a second, meters.
const SEPARATION_TOLERANCE_M: f64 = 0.3;

impl SceneObjective for CrossAhead {
    fn whose(&self) -> Whose {
        Whose::One("first")
    }

    fn others(&self) -> Vec<&AgentSelector> {
        vec![&self.to]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[PET]
    }

    fn validate(&self) -> settings::Result {
        one_agent("to", &self.to)
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let [first, other] = [agents, &self.to].map(|selector| Agents::named(states, context, selector));
        let (first, other) = (first?, other?);
        let wanted_s = context.wanted(PET, ANY_PET_S, states)?;
        let Some(crossing) = Encroachment::new(&[[&first, &other]], &wanted_s, context.dt_s)? else {
            return nothing(states);
        };
        let best = best_moment(&crossing.costs, &crossing.counts)?.neg()?;
        let lack_m = (MARGIN_M - separation_between_m(&first, &other)?)?.relu()?;
        let touching = (penalty(&lack_m, SEPARATION_TOLERANCE_M)? * pairs::counts(&first, &other)?)?.sum(1)?;
        best + (touching * context.dt_s)?
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match, footprint};
    use super::*;

    fn objective() -> CrossAhead {
        CrossAhead { to: second() }
    }

    /// The ego and a car from the right that would pass behind it, `late_m` meters later than it would meet it.
    fn crossing(late_m: f64) -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (9.6, -9.6 - late_m, std::f64::consts::FRAC_PI_2, 8.0)])
    }

    #[test]
    fn gradients_match() {
        for traffic in [crossing(1.0), crossing(12.0), Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (9.0, 0.4, 2.0, 1.5)])]
        {
            assert_gradients_match(&objective(), &traffic);
            assert_gradients_match(&objective(), &traffic.aiming_at(PET, [0.3, 0.5]));
        }
    }

    #[test]
    fn it_costs_nothing_at_the_wanted_time_and_much_if_the_other_is_first() {
        // The second passes the middle 8 m, or one second, later than the first.
        let value = |late_m: f64| crossing(late_m).aiming_at(PET, [0.9, 1.1]).potential(&objective())[0];
        assert!(value(8.0) > -0.05, "{}", value(8.0));
        assert!(value(-8.0) < -5.0, "{}", value(-8.0));
        // Within a meter of each other at the same time, they touch.
        assert!(value(0.5) < -5.0, "{}", value(0.5));
    }

    #[test]
    fn following_the_gradient_the_other_comes_later_by_what_is_asked() {
        let states = &after_ascent(&objective(), &crossing(2.0).aiming_at(PET, [0.7, 0.9]), 600)[0];
        let footprint = |agent: usize, t: usize| footprint(states, agent, t);
        let overlap = |t: usize, u: usize| footprint(0, t).overlaps(&footprint(1, u));
        let times = || 0..states[0].len();
        assert!(times().all(|t| !overlap(t, t)));
        assert!(times().any(|t| t + 4 < states[0].len() && overlap(t, t + 4)), "{states:?}");
    }
}
