//! Properties of all objectives, and the effect of single ones on trajectories.

use super::testing::{Of, Traffic, after_ascent, assert_gradients_match, assert_gradients_of_match};
use super::*;
use crate::geometry::Transform2;
use crate::guidance::road_corridors::RoadCorridors;
use crate::scene::testing::{Drive, scene};
use candle_core::{Device, Var};
use std::sync::Arc;

/// One objective of each kind, all of which cost something in [`busy`].
fn all() -> Vec<ObjectiveConfig> {
    let text = "
        objectives = [
            { kind = 'acceleration_limit', limit_mps2 = 0.5 },
            { kind = 'slip_limit', limit_rad = 0.01 },
            { kind = 'stay_on_road' },
            { kind = 'no_collision', margin_m = 1.0 },
            { kind = 'cut_in' },
            { kind = 'hard_brake', agents = 'all' },
        ]";
    let table: toml::Table = toml::from_str(text).unwrap();
    table["objectives"].clone().try_into().unwrap()
}

/// The objective for the agents that it names.
fn posed(config: &ObjectiveConfig) -> Of<&dyn SceneObjective> {
    Of(config.agents().name().to_owned().leak(), config.objective())
}

/// Accelerating cars close to each other and beside the road.
fn busy() -> Traffic {
    let mut traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 9.0), (6.0, 2.2, 0.0, 5.0), (3.0, -5.0, 0.2, 6.0)]);
    let mut states: Vec<f64> = traffic.states.flatten_all().unwrap().to_vec1().unwrap();
    for (at, state) in states.iter_mut().enumerate() {
        *state += 0.02 * ((at % 36) / 3).pow(2) as f64 * if at % 3 == 0 { 1.0 } else { 0.1 };
    }
    let states = Tensor::from_vec(states, traffic.states.shape(), &Device::Cpu).unwrap();
    traffic.states = Var::from_tensor(&states).unwrap();
    let lanes = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]).lanes;
    traffic.context.roads = vec![Arc::new(RoadCorridors::new(&lanes, &Transform2::IDENTITY))];
    traffic
}

#[test]
fn every_gradient_agrees_with_finite_differences_and_every_potential_is_negative() {
    let traffic = busy();
    for config in all() {
        let objective = posed(&config);
        match config.kind {
            // The path that is cut into is held constant.
            ObjectiveKind::CutIn(_) => assert_gradients_of_match(&objective, &traffic, |agent, _| agent > 0),
            // The allowance for turning is held constant.
            ObjectiveKind::SlipLimit(_) => assert_gradients_of_match(&objective, &traffic, |_, i| i < 2),
            _ => assert_gradients_match(&objective, &traffic),
        }
        assert!(traffic.potential(&objective)[0] < -1e-3, "{}", config.kind());
    }
}

#[test]
fn invalid_entries_never_contribute() {
    for config in all() {
        let objective = &posed(&config);
        let mut traffic = busy();
        // The third agent is padding, the second is gone at timestep 7: whatever stands there must not matter.
        let gone = |at: usize| at / 12 == 2 || at == 12 + 7;
        let valid: Vec<f64> = (0..36).map(|at| f64::from(u8::from(!gone(at)))).collect();
        let valid = Tensor::from_vec(valid, (1, 3, 12), &Device::Cpu).unwrap();
        traffic.context.latent = (&traffic.context.latent * &valid).unwrap();
        traffic.context.valid = valid;
        let (before, gradient) = (traffic.potential(objective), traffic.gradient(objective));
        assert!(before[0] < 0.0, "{}", config.kind());
        let mut states: Vec<f64> = traffic.states.flatten_all().unwrap().to_vec1().unwrap();
        for (at, state) in states.iter_mut().enumerate().filter(|(at, _)| gone(at / 3)) {
            assert_eq!(gradient[at], 0.0, "{} pulls at padding", config.kind());
            *state = 1.7 * (at % 5) as f64 - 3.0;
        }
        let states = Tensor::from_vec(states, traffic.states.shape(), &Device::Cpu).unwrap();
        traffic.states = Var::from_tensor(&states).unwrap();
        assert!((traffic.potential(objective)[0] - before[0]).abs() < 1e-12, "{} sees padding", config.kind());
    }
}

#[test]
fn what_is_observed_alone_costs_nothing() {
    let mut traffic = busy();
    traffic.context.latent = traffic.context.latent.zeros_like().unwrap();
    for config in all() {
        assert_eq!(traffic.potential(&posed(&config)), [0.0], "{}", config.kind());
    }
}

#[test]
fn rows_are_independent() {
    let (one, two) = (busy(), Traffic::straight(&[(0.0, 0.0, 0.0, 9.0), (9.0, 0.5, 0.1, 3.0), (3.0, 5.0, 0.2, 6.0)]));
    let mut both = busy();
    both.context = both.context.repeated(2).unwrap();
    let states = Tensor::cat(&[one.states.as_tensor(), two.states.as_tensor()], 0).unwrap();
    both.states = Var::from_tensor(&states).unwrap();
    for config in all() {
        let mut second = Traffic { context: one.context.clone(), states: two.states.clone() };
        let objective = posed(&config);
        let expected = [one.potential(&objective)[0], second.potential(&objective)[0]];
        let found = both.potential(&objective);
        assert!((0..2).all(|row| (found[row] - expected[row]).abs() < 1e-9), "{}", config.kind());
        // Swapping the role changes the agent.
        second.context.roles.insert("other".to_owned(), vec![2]);
        let selected = second.context.selected(&AgentSelector::new("other")).unwrap();
        assert_eq!(selected.to_vec2::<f64>().unwrap(), [[0.0, 0.0, 1.0]]);
    }
}

#[test]
fn a_jolt_beyond_the_limit_is_smoothed() {
    let traffic = Traffic::straight(&[(0.0, 0.0, 0.3, 9.0), (20.0, 0.0, 0.0, 5.0)]);
    // A jolt: one state 1 m off, which means 1 / 0.2² = 25 m/s² before and after, and 50 in the middle.
    let mut jolted = traffic.states_vec();
    jolted[0][0][6][1] += 1.0;
    let flat: Vec<f64> = jolted.concat().concat().concat();
    let states = Tensor::from_vec(flat, traffic.states.shape(), &Device::Cpu).unwrap();
    let jolted = Traffic { states: Var::from_tensor(&states).unwrap(), context: traffic.context };
    let limit = AccelerationLimit { limit_mps2: 4.0 };
    let expected = -0.5 * 0.2 * (21f64.powi(2) * 2.0 + 46f64.powi(2));
    assert!((jolted.potential(&limit)[0] / expected - 1.0).abs() < 0.01, "{}", jolted.potential(&limit)[0]);
    assert_gradients_match(&limit, &jolted);
    let calm = after_ascent(&limit, &jolted, 300);
    for t in 1..11 {
        let second = |dim: usize| calm[0][0][t - 1][dim] - 2.0 * calm[0][0][t][dim] + calm[0][0][t + 1][dim];
        assert!(second(0).hypot(second(1)) / 0.04 < 4.5);
    }
}
