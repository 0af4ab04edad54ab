//! Gradients, the miner's judgment of samples that follow them, and cases without an effect.

use super::super::testing::{Traffic, after_ascent};
use super::*;
use crate::behavior::{Behavior, BehaviorEvent, EventLabel, LeftTurn, RightTurn};
use crate::geometry::{Polyline, Transform2, Vec2};
use crate::guidance::lane_ways::LaneWays;
use crate::scene::testing::{Drive, scene};
use crate::scene::{Lane, LaneGraph, LaneId, Scene, State, Trajectory};
use candle_core::{Device, Var};
use std::sync::Arc;

const fn objective(side: Side) -> Turn {
    Turn { side }
}

/// A street along x that forks 6 m on: straight, and along a quarter of a circle of 6 m to the left and to the right.
fn junction() -> LaneGraph {
    let bend = |sign: f64| {
        let on_bend = |i: u32| f64::from(i) * std::f64::consts::FRAC_PI_2 / 240.0;
        let mut points: Vec<_> =
            (0..=240).map(|i| (6.0 + 6.0 * on_bend(i).sin(), sign * 6.0 * (1.0 - on_bend(i).cos()))).collect();
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
    let [left, right] = [is_found(LeftTurn {}.detect(scene)), is_found(RightTurn {}.detect(scene))];
    if side == Side::Left { [left, right] } else { [right, left] }
}

/// The place of the car at its speed after driving for `t` timesteps along the left bend of the junction, and its
/// heading.
fn on_bend(t: usize) -> [f64; 3] {
    let way_m = 1.6 * t as f64;
    let angle = ((way_m - 6.0) / 6.0).clamp(0.0, std::f64::consts::FRAC_PI_2);
    let beyond_m = (way_m - 6.0 - 3.0 * std::f64::consts::PI).max(0.0);
    [way_m.min(6.0) + 6.0 * angle.sin(), 6.0 * (1.0 - angle.cos()) + beyond_m, angle]
}

#[test]
fn the_cost_and_its_gradient_are_those_of_the_distance_from_the_place_on_the_way() {
    for generates_headings in [false, true] {
        let mut traffic = traffic(junction());
        traffic.context.generates_headings = generates_headings;
        let (mut cost, mut gradient) = (0.0, vec![[0.0; 3]; 12]);
        for t in traffic.generated() {
            // The car goes straight on; at 8 m/s it is around the bend within the scene.
            let [x, y, heading] = on_bend(t);
            let (dx, dy) = (1.6 * t as f64 - x, 0.1 - y);
            let aside_m = dx.hypot(dy);
            let excess_m = (aside_m - 1.0).max(0.0);
            cost += 0.5 * excess_m.powi(2);
            if excess_m > 0.0 {
                gradient[t] = [-excess_m * dx / aside_m, -excess_m * dy / aside_m, 0.0];
            }
            if generates_headings {
                cost += (1.0 - heading.cos()) / 0.09;
                gradient[t][2] = heading.sin() / 0.09;
            }
        }
        // The bend has 240 pieces, and norms are rounded.
        let n = traffic.n_generated() as f64;
        let found = -traffic.potential(&objective(Side::Left))[0];
        assert!((found - cost / n).abs() < 0.01 * found, "{found}, expected {}", cost / n);
        for (t, found) in traffic.gradient(&objective(Side::Left)).chunks(3).enumerate() {
            for (found, expected) in found.iter().zip(gradient[t]) {
                assert!((found - expected / n).abs() < 0.03, "timestep {t}: {found}, expected {}", expected / n);
            }
        }
    }
}

#[test]
fn following_the_gradient_the_miner_finds_the_turn_and_nothing_is_left_to_pay() {
    for side in [Side::Left, Side::Right] {
        for lanes in [junction(), LaneGraph::default()] {
            let traffic = traffic(lanes.clone());
            assert_eq!(found(&driven(&traffic.states_vec()[0][0], lanes.clone()), side), [false, false]);
            let states = &after_ascent(&objective(side), &traffic, 30)[0][0];
            assert_eq!(found(&driven(states, lanes), side), [true, false], "{states:?}");
            assert!(with_states(traffic, states.concat()).potential(&objective(side))[0] > -1e-3);
        }
    }
}

#[test]
fn nothing_is_asked_of_who_turns_already_or_nowhere() {
    let straight = lanes(vec![(1, vec![(-50.0, 0.0), (60.0, 0.0)], vec![])]);
    assert_eq!(traffic(straight).potential(&objective(Side::Left)), [0.0]);
    let turned = with_states(traffic(junction()), (0..12).flat_map(on_bend).collect());
    assert_eq!(turned.potential(&objective(Side::Left))[0].abs(), 0.0);
    // A turn to the other side costs more, and so does a slower one.
    assert!(turned.potential(&objective(Side::Right))[0] < -1.0);
    let slower = turned.aiming_at(MEAN_SPEED, [1.0, 2.0]).aiming_at(HEADING_CHANGE, [0.8, 2.6]);
    assert!(slower.potential(&objective(Side::Left))[0] < -0.3);
}

fn with_states(mut traffic: Traffic, states: Vec<f64>) -> Traffic {
    let states = Tensor::from_vec(states, traffic.states.shape(), &Device::Cpu).unwrap();
    traffic.states = Var::from_tensor(&states).unwrap();
    traffic
}

#[test]
fn states_that_are_not_there_do_not_count() {
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
    // The car, which goes straight on, is closer to where a smaller turn ends.
    assert!(asked.potential(&objective(Side::Right))[0] > free + 0.1);
    // No lane turns by half a circle.
    asked.context.targets[0] = [(HEADING_CHANGE.to_owned(), [-3.2, -3.0])].into();
    assert_eq!(asked.potential(&objective(Side::Right)), [0.0]);
}

/// Identifier, center line and successors.
type LaneRow = (i64, Vec<(f64, f64)>, Vec<i64>);

fn lanes(lanes: Vec<LaneRow>) -> LaneGraph {
    let lane = |(id, points, successors): LaneRow| {
        let points = points.into_iter().map(|(x, y)| Vec2::new(x, y)).collect();
        let lane = Lane::unconnected(id, Polyline(points), Default::default());
        Lane { successors: successors.into_iter().map(LaneId).collect(), ..lane }
    };
    LaneGraph::new(lanes.into_iter().map(lane).collect())
}
