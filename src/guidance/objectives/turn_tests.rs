//! Gradients, the miner's view of what following them does, and what is not asked.

use super::super::testing::{Traffic, after_ascent, assert_gradients_of_generated_match};
use super::*;
use crate::behavior::{Behavior, BehaviorEvent, EventLabel, LeftTurn, RightTurn};
use crate::geometry::{Polyline, Transform2, Vec2};
use crate::guidance::lane_ways::LaneWays;
use crate::scene::testing::{Drive, scene};
use crate::scene::{Lane, LaneGraph, LaneId, Scene, State, Trajectory};
use candle_core::{Device, Var};
use std::sync::Arc;

fn objective(side: Side) -> Turn {
    let side = if side == Side::Left { "left" } else { "right" };
    toml::from_str(&format!("agents = 'ego'\nside = '{side}'")).expect("everything else has a default")
}

/// A street along x that forks 6 m on: straight, and along a quarter of a circle of 6 m to the left and to the right.
fn junction() -> LaneGraph {
    let bend = |sign: f64| {
        let on_bend = |i: u32| f64::from(i) * std::f64::consts::FRAC_PI_2 / 24.0;
        let mut points: Vec<_> =
            (0..=24).map(|i| (6.0 + 6.0 * on_bend(i).sin(), sign * 6.0 * (1.0 - on_bend(i).cos()))).collect();
        points.push((12.0, sign * 40.0));
        points
    };
    let straight = vec![(6.0, 0.0), (60.0, 0.0)];
    lanes(vec![
        (1, vec![(-50.0, 0.0), (6.0, 0.0)], vec![2, 3, 4]),
        (2, straight, vec![]),
        (3, bend(1.0), vec![]),
        (4, bend(-1.0), vec![]),
    ])
}

/// A car that drives straight along x at 8 m/s, whose headings follow its motion.
fn traffic(lanes: LaneGraph) -> Traffic {
    let mut traffic = Traffic::straight(&[(0.0, 0.1, 0.0, 8.0)]);
    traffic.context.generates_headings = false;
    traffic.context.ways = vec![Arc::new(LaneWays::new(&lanes.into(), &Transform2::IDENTITY))];
    traffic
}

/// The car of `states`, (T, 3), in a scene: headings are those of its motion.
fn driven(states: &[Vec<f64>], lanes: LaneGraph) -> Scene {
    let base = scene(&[Drive::straight(0.0, 0.0, 0.0, 8.0)]);
    let position = |t: usize| Vec2::new(states[t][0], states[t][1]);
    let state = |t: usize| {
        let (a, b) = if t == 0 { (0, 1) } else { (t - 1, t) };
        let velocity = (position(b) - position(a)) * (1.0 / 0.2);
        Some(State { position: position(t), heading_rad: velocity.angle(), velocity })
    };
    let mut track = base.tracks[0].clone();
    track.trajectory = Trajectory::new((0..states.len()).map(state).collect());
    Scene { dt_s: 0.2, n_history: 3, tracks: vec![track], lanes: Arc::new(lanes), ..base }
}

/// Whether the miner finds a turn to this side, and whether it finds one to the other.
fn found(scene: &Scene, side: Side) -> [bool; 2] {
    let is_found = |events: Vec<BehaviorEvent>| events.iter().any(|event| event.label == EventLabel::Positive);
    let [left, right] = [is_found(LeftTurn::default().detect(scene)), is_found(RightTurn::default().detect(scene))];
    if side == Side::Left { [left, right] } else { [right, left] }
}

#[test]
fn gradients_agree_with_finite_differences() {
    for side in [Side::Left, Side::Right] {
        for lanes in [junction(), LaneGraph::default()] {
            let slow = Turn { mean_speed_mps: Some([2.0, 4.0]), ..objective(side) };
            assert_gradients_of_generated_match(&slow, &traffic(lanes));
        }
    }
}

#[test]
fn following_the_gradient_the_miner_finds_the_turn_and_nothing_is_left_to_pay() {
    for side in [Side::Left, Side::Right] {
        for lanes in [junction(), LaneGraph::default()] {
            let traffic = traffic(lanes.clone());
            assert_eq!(found(&driven(&traffic.states_vec()[0][0], lanes.clone()), side), [false, false]);
            let states = &after_ascent(&objective(side), &traffic, 300)[0][0];
            assert_eq!(found(&driven(states, lanes), side), [true, false], "{states:?}");
            let mut turned = traffic;
            let flat = Tensor::from_vec(states.concat(), turned.states.shape(), &Device::Cpu).unwrap();
            turned.states = Var::from_tensor(&flat).unwrap();
            assert!(turned.potential(&objective(side))[0] > -1e-3);
        }
    }
}

#[test]
fn the_cost_is_that_of_the_way_and_of_the_place_on_it() {
    // The car goes straight on a street that turns nowhere: there is nothing to gain.
    let straight = lanes(vec![(1, vec![(-50.0, 0.0), (60.0, 0.0)], vec![])]);
    assert_eq!(traffic(straight).potential(&objective(Side::Left)), [0.0]);
    // Driven along the middle of the bend, at 8 m/s from x = 0 on, it has turned by 90 degrees at 15.4 m: all is as asked,
    // but for a speed that is not.
    let mut turned = traffic(junction());
    let place = |t: usize| {
        let way_m = 1.6 * t as f64;
        let angle = ((way_m - 6.0) / 6.0).clamp(0.0, std::f64::consts::FRAC_PI_2);
        let beyond_m = (way_m - 6.0 - 3.0 * std::f64::consts::PI).max(0.0);
        [way_m.min(6.0) + 6.0 * angle.sin(), 6.0 * (1.0 - angle.cos()) + beyond_m, angle]
    };
    let states: Vec<f64> = (0..12).flat_map(place).collect();
    let states = Tensor::from_vec(states, turned.states.shape(), &Device::Cpu).unwrap();
    turned.states = Var::from_tensor(&states).unwrap();
    assert_eq!(turned.potential(&objective(Side::Left))[0].abs(), 0.0);
    let slower = Turn { mean_speed_mps: Some([4.0, 5.0]), ..objective(Side::Left) };
    // 3 m/s too fast, but for the chords of the bend: ½ · 3².
    let cost = -turned.potential(&slower)[0];
    assert!((4.2..=4.5).contains(&cost), "{cost}");
    // A turn to the other side is another matter.
    assert!(turned.potential(&objective(Side::Right))[0] < -1.0);
}

#[test]
fn states_that_are_not_there_do_not_count_and_the_last_one_decides() {
    let mut gone = traffic(junction());
    let valid = |n: usize| {
        Tensor::from_vec((0..12).map(|t| f64::from(u8::from(t < n))).collect::<Vec<_>>(), (1, 1, 12), &Device::Cpu)
            .unwrap()
    };
    gone.context.valid = valid(8);
    gone.context.latent = (&gone.context.latent * valid(8)).unwrap();
    let gradient = gone.gradient(&objective(Side::Left));
    assert!(gradient[3 * 8..].iter().all(|g| *g == 0.0));
    assert!(gradient[3 * 7..3 * 8].iter().any(|g| g.abs() > 0.1));
    // Observed states cost nothing.
    gone.context.latent = gone.context.latent.zeros_like().unwrap();
    assert_eq!(gone.potential(&objective(Side::Left)), [0.0]);
}

#[test]
fn the_target_decides_what_is_left_open() {
    let mut asked = traffic(junction());
    let free = asked.potential(&objective(Side::Right))[0];
    asked.context.targets[0] = [(HEADING_CHANGE.to_owned(), [-1.5, -1.4])].into();
    assert!(asked.potential(&objective(Side::Right))[0] < free);
    // No lane turns by half a circle.
    asked.context.targets[0] = [(HEADING_CHANGE.to_owned(), [-3.2, -3.0])].into();
    assert_eq!(asked.potential(&objective(Side::Right)), [0.0]);
}

fn lanes(lanes: Vec<(i64, Vec<(f64, f64)>, Vec<i64>)>) -> LaneGraph {
    let lane = |(id, points, successors): (i64, Vec<(f64, f64)>, Vec<i64>)| {
        let points = points.into_iter().map(|(x, y)| Vec2::new(x, y)).collect();
        let lane = Lane::unconnected(id, Polyline(points), Default::default());
        Lane { successors: successors.into_iter().map(LaneId).collect(), ..lane }
    };
    LaneGraph::new(lanes.into_iter().map(lane).collect())
}
