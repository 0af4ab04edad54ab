//! Traffic for tests of objectives, in double precision: gradients against finite differences, and the effect of
//! following them.

use super::{SceneObjective, Whose};
use crate::geometry::{OrientedBox, Polyline, Transform2, Vec2};
use crate::guidance::lane_ways::LaneWays;
use crate::guidance::{AgentSelector, SceneContext};
use crate::scene::{Lane, LaneGraph};
use candle_core::{Device, Result, Tensor, Var};
use std::ops::Range;

const N_TIMESTEPS: usize = 12;
const N_HISTORY: usize = 3;
const DT_S: f64 = 0.2;

/// A batch of one row with its context. Agent 0 is the ego, agent 1 the other one of every pair.
pub(super) struct Traffic {
    pub(super) states: Var,
    pub(super) context: SceneContext,
}

impl Traffic {
    /// Cars of 4.5 m by 1.8 m that drive straight on from (x, y, heading, speed), observed over the first timesteps.
    pub(super) fn straight(cars: &[(f64, f64, f64, f64)]) -> Self {
        let mut states = Vec::new();
        for (x, y, heading_rad, speed_mps) in cars {
            for timestep in 0..N_TIMESTEPS {
                let way_m = speed_mps * DT_S * timestep as f64;
                states.extend([x + way_m * heading_rad.cos(), y + way_m * heading_rad.sin(), *heading_rad]);
            }
        }
        let n_agents = cars.len();
        let device = Device::Cpu;
        let latent: Vec<f64> =
            (0..n_agents * N_TIMESTEPS).map(|at| f64::from(u8::from(at % N_TIMESTEPS >= N_HISTORY))).collect();
        let context = SceneContext {
            dt_s: DT_S,
            n_history: N_HISTORY,
            generates_headings: true,
            valid: Tensor::from_vec(vec![1.0; n_agents * N_TIMESTEPS], (1, n_agents, N_TIMESTEPS), &device).unwrap(),
            latent: Tensor::from_vec(latent, (1, n_agents, N_TIMESTEPS), &device).unwrap(),
            extent_m: Tensor::from_vec([4.5, 1.8].repeat(n_agents), (1, n_agents, 2), &device).unwrap(),
            motorized: Tensor::from_vec(vec![1.0; n_agents], (1, n_agents), &device).unwrap(),
            roads: vec![std::sync::Arc::default()],
            ways: vec![std::sync::Arc::new(ways(Vec::new()))],
            ego: vec![0],
            targets: vec![std::collections::BTreeMap::new()],
            roles: [("agent", 0), ("first", 0), ("second", 1), ("other", 1)]
                .map(|(role, idx)| (role.to_owned(), vec![idx.min(n_agents - 1)]))
                .into(),
        };
        let states = Tensor::from_vec(states, (1, n_agents, N_TIMESTEPS, 3), &device).unwrap();
        Self { states: Var::from_tensor(&states).unwrap(), context }
    }

    /// The traffic with a target range for a parameter.
    pub(super) fn aiming_at(mut self, parameter: &str, range: [f64; 2]) -> Self {
        self.context.targets[0].insert(parameter.to_owned(), range);
        self
    }

    pub(super) fn generated(&self) -> Range<usize> {
        N_HISTORY..N_TIMESTEPS
    }

    pub(super) fn n_generated(&self) -> usize {
        N_TIMESTEPS - N_HISTORY
    }

    pub(super) fn states_vec(&self) -> Vec<Vec<Vec<Vec<f64>>>> {
        nested(self.states.as_tensor())
    }

    pub(super) fn potential(&self, objective: &dyn SceneObjective) -> Vec<f64> {
        log_potential(objective, self.states.as_tensor(), &self.context).to_vec1().unwrap()
    }

    /// The gradient with respect to every state.
    pub(super) fn gradient(&self, objective: &dyn SceneObjective) -> Vec<f64> {
        let total = log_potential(objective, self.states.as_tensor(), &self.context).sum_all().unwrap();
        let gradients = total.backward().unwrap();
        gradients.get(self.states.as_tensor()).unwrap().flatten_all().unwrap().to_vec1().unwrap()
    }
}

/// An objective for other agents than usual.
pub(super) struct Of<O>(pub(super) &'static str, pub(super) O);

impl<O: std::ops::Deref<Target: SceneObjective>> SceneObjective for Of<O> {
    fn whose(&self) -> Whose {
        Whose::Any(self.0)
    }

    fn log_potential(&self, agents: &AgentSelector, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        self.1.log_potential(agents, states, context)
    }
}

fn log_potential(objective: &dyn SceneObjective, states: &Tensor, context: &SceneContext) -> Tensor {
    let (Whose::Any(usual) | Whose::One(usual)) = objective.whose();
    objective.log_potential(&AgentSelector::new(usual), states, context).unwrap()
}

/// Two lanes along x beside each other, with center lines at y = 0 and 3.5 m.
pub(super) fn two_lanes() -> LaneWays {
    ways(vec![(1, vec![(-50.0, 0.0), (100.0, 0.0)]), (2, vec![(-50.0, 3.5), (100.0, 3.5)])])
}

fn ways(lanes: Vec<(i64, Vec<(f64, f64)>)>) -> LaneWays {
    let lane = |(id, points): (i64, Vec<(f64, f64)>)| {
        let centerline = Polyline(points.into_iter().map(|(x, y)| Vec2::new(x, y)).collect());
        Lane::unconnected(id, centerline, Default::default())
    };
    LaneWays::new(&LaneGraph::new(lanes.into_iter().map(lane).collect()).into(), &Transform2::IDENTITY)
}

pub(super) fn nested(states: &Tensor) -> Vec<Vec<Vec<Vec<f64>>>> {
    (0..states.dim(0).unwrap()).map(|row| states.get(row).unwrap().to_vec3().unwrap()).collect()
}

/// Compares the gradient of every entry with central differences; some of it must not be zero.
pub(super) fn assert_gradients_match(objective: &dyn SceneObjective, traffic: &Traffic) {
    assert_gradients_of_match(objective, traffic, |_, _| true);
}

/// [`assert_gradients_match`] for the entries of some agents, by their indices, and of some of x, y and heading.
pub(super) fn assert_gradients_of_match(
    objective: &dyn SceneObjective,
    traffic: &Traffic,
    is_compared: impl Fn(usize, usize) -> bool,
) {
    let is_compared = |at: usize| is_compared(at / (3 * N_TIMESTEPS), at % 3);
    let gradient = traffic.gradient(objective);
    let states: Vec<f64> = traffic.states.flatten_all().unwrap().to_vec1().unwrap();
    let value = |at: usize, h: f64| {
        let mut moved = states.clone();
        moved[at] += h;
        let moved = Tensor::from_vec(moved, traffic.states.shape(), &Device::Cpu).unwrap();
        let potential = log_potential(objective, &moved, &traffic.context);
        potential.sum_all().unwrap().to_scalar::<f64>().unwrap()
    };
    let largest = gradient.iter().map(|g| g.abs()).fold(0.0, f64::max);
    assert!(largest > 1e-3, "there is no gradient");
    let h = 1e-5;
    for (at, own) in gradient.iter().enumerate().filter(|(at, _)| is_compared(*at)) {
        let expected = (value(at, h) - value(at, -h)) / (2.0 * h);
        assert!((own - expected).abs() < 1e-4 * largest, "entry {at}: {own}, expected {expected}");
    }
}

/// The states after `n_steps` steps along the gradient, each as long as would bring a quadratic potential to zero; only
/// generated states move.
pub(super) fn after_ascent(
    objective: &dyn SceneObjective,
    traffic: &Traffic,
    n_steps: usize,
) -> Vec<Vec<Vec<Vec<f64>>>> {
    let mut moved = Traffic {
        states: Var::from_tensor(&traffic.states.as_detached_tensor().copy().unwrap()).unwrap(),
        context: traffic.context.clone(),
    };
    let latent: Vec<f64> = traffic.context.latent.flatten_all().unwrap().to_vec1().unwrap();
    for _ in 0..n_steps {
        let potential: f64 = moved.potential(objective).iter().sum();
        let mut gradient = moved.gradient(objective);
        gradient.iter_mut().enumerate().for_each(|(at, g)| *g *= latent[at / 3]);
        let squared: f64 = gradient.iter().map(|g| g * g).sum();
        if squared < 1e-18 {
            break;
        }
        let step = -2.0 * potential / squared;
        let mut states: Vec<f64> = moved.states.flatten_all().unwrap().to_vec1().unwrap();
        states.iter_mut().zip(&gradient).for_each(|(state, g)| *state += step * g);
        let states = Tensor::from_vec(states, traffic.states.shape(), &Device::Cpu).unwrap();
        moved = Traffic { states: Var::from_tensor(&states).unwrap(), context: moved.context };
    }
    nested(moved.states.as_tensor())
}

/// The box of a car at a timestep of the states of one row.
pub(super) fn footprint(states: &[Vec<Vec<f64>>], agent: usize, t: usize) -> OrientedBox {
    let [x, y, heading_rad] = states[agent][t][..] else { unreachable!() };
    OrientedBox { center: Vec2::new(x, y), heading_rad, length_m: 4.5, width_m: 1.8 }
}
