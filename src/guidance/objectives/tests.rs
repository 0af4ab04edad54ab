//! Properties of all objectives, and the effect of single ones on trajectories.

use super::testing::{Of, Traffic, after_ascent, assert_gradients_match, assert_gradients_of_match, nested};
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
            { kind = 'target_speed', speed_mps = 3.0 },
            { kind = 'speed_limit', limit_mps = 4.0 },
            { kind = 'goal', agents = 'all', x_m = 30.0, y_m = 2.0, time_s = 1.0 },
            { kind = 'acceleration_limit', limit_mps2 = 0.5 },
            { kind = 'slip_limit', limit_rad = 0.01 },
            { kind = 'stay_on_road' },
            { kind = 'no_collision', margin_m = 1.0 },
            { kind = 'keep_distance', min_m = 9.0 },
            { kind = 'stop_at_line', agents = 'all', distance_m = 5.0 },
            { kind = 'cut_in' },
            { kind = 'cross_ahead', agents = 'ego', to = 'other' },
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

fn speeds(agent: &[Vec<f64>], dt_s: f64) -> Vec<f64> {
    agent.windows(2).map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]) / dt_s).collect()
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
fn target_speed_is_reached_by_the_chosen_agent() {
    let traffic = Traffic::straight(&[(0.0, 0.0, 0.3, 9.0), (20.0, 0.0, 0.0, 8.0)]);
    let objective = Of("other", &TargetSpeed { speed_mps: 5.0 });
    // 3 m/s too fast from the present on: steps 2 to 10 of 0.2 s each.
    let expected = -0.5 * 9.0 * 9.0 * 0.2;
    assert!((traffic.potential(&objective)[0] / expected - 1.0).abs() < 0.05, "{}", traffic.potential(&objective)[0]);
    assert_gradients_match(&objective, &traffic);
    let states = after_ascent(&objective, &traffic, 1000);
    assert!(speeds(&states[0][1], 0.2)[2..].iter().all(|speed| (speed - 5.0).abs() < 0.3));
    assert_eq!(states[0][0], traffic.states_vec()[0][0]);
}

#[test]
fn limits_bind_those_beyond_them_only() {
    let traffic = Traffic::straight(&[(0.0, 0.0, 0.3, 9.0), (20.0, 0.0, 0.0, 5.0)]);
    let limit = SpeedLimit { limit_mps: 6.0 };
    assert_gradients_match(&limit, &traffic);
    let states = after_ascent(&limit, &traffic, 200);
    assert!(speeds(&states[0][0], 0.2)[2..].iter().all(|speed| *speed < 6.2));
    assert_eq!(states[0][1], traffic.states_vec()[0][1]);

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

#[test]
fn goals_are_reached_in_time() {
    let traffic = Traffic::straight(&[(0.0, 0.0, 0.0, 9.0), (20.0, 5.0, std::f64::consts::FRAC_PI_2, 5.0)]);
    let goal = |time_s: Option<f64>| Of("other", Box::new(Goal { x_m: 12.0, y_m: 1.0, time_s }));
    // The other drives along y and is at (20, 7) at present, timestep 2: 12 m ahead and 1 m to the left is (19, 19).
    for (objective, timestep, expected) in [(goal(Some(1.0)), 7, [19.0, 19.0]), (goal(None), 11, [19.0, 19.0])] {
        let now = &traffic.states_vec()[0][1][timestep];
        let miss = (now[0] - expected[0]).powi(2) + (now[1] - expected[1]).powi(2);
        assert!((traffic.potential(&objective)[0] + 0.5 * miss).abs() < 1e-9);
        assert_gradients_match(&objective, &traffic);
        let there = &after_ascent(&objective, &traffic, 10)[0][1][timestep];
        assert!((there[0] - expected[0]).abs() + (there[1] - expected[1]).abs() < 1e-6);
    }
}

#[test]
fn the_front_stops_at_the_line() {
    // At present, timestep 2, the car is 2 m along its way; the line lies 6 m ahead of that.
    let traffic = Traffic::straight(&[(0.0, 0.0, std::f64::consts::FRAC_PI_2, 5.0)]);
    let objective = StopAtLine { distance_m: 6.0 };
    assert_gradients_match(&objective, &traffic);
    let states = &after_ascent(&objective, &traffic, 500)[0][0];
    assert!(states.iter().all(|state| state[1] < 8.0 + 0.1));
    assert!((states[11][1] - 8.0).abs() < 0.2, "{:?}", states[11]);
    assert!(speeds(states, 0.2)[10] < 0.2);
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let refusal = |text: &str| match toml::from_str::<ObjectiveConfig>(text) {
        Ok(config) => config.validate(&["ego", "other"]).unwrap_err().to_string(),
        Err(error) => error.to_string(),
    };
    for (text, part) in [
        ("kind = 'target_speed'\nspeed_mps = -1.0", "speed_mps is -1"),
        ("kind = 'target_speed'\nspeed_mps = 5.0\nweight = -2.0", "weight is -2"),
        ("kind = 'target_speed'\nspeed_mps = 5.0\nagents = 'third'", "expected one of all, ego, other"),
        ("kind = 'target_speed'\nspeed = 5.0", "speed"),
        ("kind = 'keep_distance'\nmin_m = 5.0\nmax_m = 3.0", "min_m is 5, expected at most max_m, which is 3"),
        ("kind = 'stop_at_line'\ndistance_m = nan", "distance_m is NaN"),
        ("kind = 'goal'\nx_m = inf\ny_m = 0.0", "x_m is inf"),
        ("kind = 'no_collision'\nmargin_m = -0.5", "margin_m is -0.5"),
        ("kind = 'cut_in'\nagents = 'all'", "expected one agent"),
    ] {
        let message = refusal(text);
        assert!(message.contains(part), "{message}");
    }
    assert!(all().iter().all(|config| config.validate(&["ego", "other"]).is_ok()));
    assert_eq!(nested(busy().states.as_tensor()).len(), 1);
}
