//! Stay on the road.

use super::motion::{integral, norm, penalty, positions};
use super::{AgentSelector, SceneContext, SceneObjective};
use crate::geometry::Vec2;
use candle_core::{DType, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Stay on the road: J = -½ Σ ∫ (max(e(t) - e₀, 0) / τ)² dt with e(t) = max(d(p(t)), 0), over the centers
/// of the chosen motorized agents.
///
/// e₀ is the excess e of the agent where it was last observed, so that only what a sample adds to it counts: who is
/// parked beside the road, or enters it from there, is not dragged onto it.
///
/// d(p) is how far p lies outside of the nearest lane corridor: its distance to the center line of the lane less half
/// the lane's width (that of the map's boundaries, 3.5 m where it has none), negative inside. Beyond ends that no lane
/// continues, lanes are carried straight on by 100 m. The nearest corridor is found on the host; by the envelope
/// theorem the gradient of the distance to its nearest point, held fixed, is that of d, except where two corridors are
/// equally near. The potential is 0 in scenes without lanes and at places whose maps lack parts of the road, and agents
/// that are not motorized do not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StayOnRoad {}

/// The distance τ off the road that costs ½ a second, meters.
const TOLERANCE_M: f64 = 0.5;

impl SceneObjective for StayOnRoad {
    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let agents = (context.selected(agents)? * &context.motorized)?;
        let terms = context.terms(0)?;
        let counts = terms.broadcast_mul(&agents.unsqueeze(2)?)?;
        let last_observed = last_observed(context)?.broadcast_mul(&agents.unsqueeze(2)?)?;
        let centers = positions(states)?;
        let excess_m = |at: &Tensor| outside_m(&centers, at, context)?.relu();
        let observed_m = excess_m(&last_observed)?.max_keepdim(2)?;
        let added_m = excess_m(&counts)?.broadcast_sub(&observed_m)?.relu()?;
        integral(&penalty(&added_m, TOLERANCE_M)?, &terms, &agents, context.dt_s)
    }
}

/// 1 at the timestep at which each agent was last observed up to the present, or otherwise first observed, (B, A, T).
fn last_observed(context: &SceneContext) -> Result<Tensor> {
    let observed = (&context.valid * (1.0 - &context.latent)?)?;
    let n_timesteps = observed.dim(2)?;
    let mut marks = observed.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
    for agent in marks.chunks_exact_mut(n_timesteps) {
        let (past, future) = agent.split_at(context.n_history.min(n_timesteps));
        let first_later = || Some(past.len() + future.iter().position(|mark| *mark > 0.0)?);
        let last = past.iter().rposition(|mark| *mark > 0.0).or_else(first_later);
        agent.fill(0.0);
        if let Some(last) = last {
            agent[last] = 1.0;
        }
    }
    Tensor::from_vec(marks, observed.shape(), observed.device())?.to_dtype(observed.dtype())
}

/// How far `points` (B, A, T, 2) are outside the nearest corridor, (B, A, T); far inside if they do not count (`counts`
/// (B, A, T) is 0) or there are no lanes.
fn outside_m(points: &Tensor, counts: &Tensor, context: &SceneContext) -> Result<Tensor> {
    let (n_rows, n_agents, n_timesteps, _) = points.dims4()?;
    let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
    let (at, counted) = (host(points)?, host(counts)?);
    let n_entries = counted.len();
    let (mut nearest, mut half_width_m) = (at.clone(), vec![INSIDE_M; n_entries]);
    for (entry, point) in at.chunks_exact(2).enumerate().filter(|(entry, _)| counted[*entry] > 0.0) {
        let road = &context.roads[entry / (n_agents * n_timesteps)];
        if let Some(near) = road.nearest(Vec2::new(point[0], point[1])) {
            nearest[entry * 2..entry * 2 + 2].copy_from_slice(&[near.point.x, near.point.y]);
            half_width_m[entry] = near.half_width_m;
        }
    }
    let nearest = Tensor::from_vec(nearest, points.shape(), points.device())?.to_dtype(points.dtype())?;
    let half_width_m = Tensor::from_vec(half_width_m, (n_rows, n_agents, n_timesteps), points.device())?;
    norm(&(points - nearest)?)? - half_width_m.to_dtype(points.dtype())?
}

/// Half the width of a road that is everywhere, meters.
const INSIDE_M: f64 = 1e6;

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_match};
    use super::*;
    use crate::geometry::Transform2;
    use crate::scene::testing::{Drive, scene};
    use std::sync::Arc;

    fn on_road() -> StayOnRoad {
        StayOnRoad {}
    }

    /// Cars that drift off a lane along y = 0 whose edges are at ±1.75 m.
    fn traffic() -> Traffic {
        let cars = [(0.0, -0.5, 0.12, 12.0), (10.0, -0.5, 0.1, 14.0), (20.0, 0.4, -0.2, 10.0)];
        Traffic { context: context(&cars), ..Traffic::straight(&cars) }
    }

    fn context(cars: &[(f64, f64, f64, f64)]) -> SceneContext {
        let lanes = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]).lanes;
        let road = crate::guidance::road_corridors::RoadCorridors::new(&lanes, &Transform2::IDENTITY);
        SceneContext { roads: vec![Arc::new(road)], ..Traffic::straight(cars).context }
    }

    /// The cost per second of a car along the lane that was observed `observed_m` beside its middle and then is at
    /// `sampled_m`.
    fn cost(observed_m: f64, sampled_m: f64) -> f64 {
        let car = [(0.0, observed_m, 0.0, 5.0)];
        let mut traffic = Traffic { context: context(&car), ..Traffic::straight(&car) };
        let shift: Vec<f64> = traffic.context.latent.flatten_all().unwrap().to_vec1().unwrap();
        let shift = shift.iter().flat_map(|latent| [0.0, latent * (sampled_m - observed_m), 0.0]).collect();
        let shift = Tensor::from_vec(shift, traffic.states.shape(), traffic.states.device()).unwrap();
        traffic.states = candle_core::Var::from_tensor(&(traffic.states.as_tensor() + shift).unwrap()).unwrap();
        -traffic.potential(&on_road())[0] / (traffic.n_generated() as f64 * traffic.context.dt_s)
    }

    #[test]
    fn the_cost_is_that_of_the_distance_outside() {
        let expected = |outside_m: f64| 0.5 * (outside_m / 0.5).powi(2);
        // 2 m outside, 4 tolerances; the norm's rounding is below 1 mm here.
        let found = cost(0.0, 3.75);
        assert!((found - expected(2.0)).abs() < 0.3, "{found}");
        // Without lanes, or if the map lacks parts of the road, there is no road to leave.
        let mut traffic = traffic();
        assert!(traffic.potential(&on_road())[0] < 0.0);
        traffic.context = traffic.context.with_roads_where(|_| false);
        assert_eq!(traffic.potential(&on_road()), [0.0]);
    }

    #[test]
    fn who_is_beside_the_road_is_charged_for_going_further_only() {
        assert_eq!(cost(3.75, 3.75), 0.0, "parked");
        assert_eq!(cost(3.75, 1.0), 0.0, "enters the road");
        let found = cost(3.75, 4.75);
        assert!((found - 0.5 * (1.0f64 / 0.5).powi(2)).abs() < 0.1, "{found}");
    }

    #[test]
    fn gradients_match_and_bring_vehicles_back() {
        let traffic = traffic();
        assert_gradients_match(&on_road(), &traffic);
        let states = after_ascent(&on_road(), &traffic, 200);
        for (agent, own) in states[0].iter().enumerate() {
            assert!(own[traffic.generated()].iter().all(|state| state[1].abs() < 1.85), "agent {agent}: {own:?}");
        }
        // An agent on the road is left alone.
        assert_eq!(states[0][0][4], traffic.states_vec()[0][0][4]);
    }

    #[test]
    fn agents_that_do_not_drive_are_free() {
        let mut traffic = traffic();
        traffic.context.motorized = traffic.context.motorized.zeros_like().unwrap();
        assert_eq!(traffic.potential(&on_road()), [0.0]);
    }
}
