//! Near misses that are planned, against the miner.

use super::NearMiss;
use crate::behavior::outcome::Outcome;
use crate::behavior::testing::going_on;
use crate::behavior::{Behavior, EventLabel};
use crate::geometry::Vec2;
use crate::scene::testing::Drive;
use crate::scene::{LaneGraph, Scene, State, TrackId, Trajectory};
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

/// Vehicles that go straight on, without lanes.
fn scene(drives: &[Drive]) -> Scene {
    going_on(drives, LaneGraph::default())
}

fn outcomes(scene: &Scene) -> Vec<Outcome> {
    let mut unknown = scene.clone();
    for track in &mut unknown.tracks {
        let known = |(t, state): (usize, &Option<State>)| state.filter(|_| t < scene.n_history);
        track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(known).collect());
    }
    let found = NearMiss::default().feasible(scene, &[0, 1]);
    assert_eq!(found, NearMiss::default().feasible(&unknown, &[0, 1]), "the recorded future was looked at");
    found
}

fn crossing() -> Scene {
    scene(&[Drive::straight(0.0, 0.0, 0.0, 8.0), Drive::straight(20.0, -20.0, FRAC_PI_2, 8.0)])
}

fn toward_a_queue() -> Scene {
    scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(26.0, 0.0, 0.0, 1.0)])
}

#[test]
fn the_miner_finds_the_near_miss_that_templates_were_solved_for() {
    let behavior = NearMiss::default();
    for (name, scene) in [("crossing", crossing()), ("queue", toward_a_queue())] {
        let found = outcomes(&scene);
        let n_by_time = found.iter().filter(|outcome| outcome.get("pet_s").is_some()).count();
        assert!(found.len() - n_by_time >= 3, "{name} {found:?}");
        assert_eq!(n_by_time > 0, name == "crossing");
        for outcome in &found {
            let kind = if outcome.get("pet_s").is_some() { "pet_s" } else { "min_ttc_s" };
            let value = outcome.get(kind).unwrap();
            let wanted = BTreeMap::from([(kind.to_owned(), [value - 1e-6, value + 1e-6])]);
            let template = behavior.template(&scene, &[0, 1], &wanted, 0).unwrap();
            assert_eq!(template.agents().collect::<Vec<_>>(), [0, 1]);
            let mut changed = scene.clone();
            template.apply(&mut changed);
            let event = behavior.detect(&changed).pop().unwrap_or_else(|| panic!("{name}, {outcome:?}: nothing"));
            assert_eq!(event.label, EventLabel::Positive, "{name}, {outcome:?}, {event:?}");
            assert!((event.parameters[kind] - value).abs() < 1e-6, "{name}, {outcome:?}, {event:?}");
        }
    }
}

/// Whether a vehicle can come to a near miss with one this far ahead, meters, at these speeds, m/s.
fn comes_close(speeds_mps: [f64; 2], ahead_m: f64, are_sized: bool) -> bool {
    let [own_mps, their_mps] = speeds_mps;
    let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, own_mps), Drive::straight(ahead_m, 0.0, 0.0, their_mps)]);
    if !are_sized {
        scene.tracks.iter_mut().for_each(|track| track.extent = None);
    }
    !NearMiss { recorded_sizes: false, ..NearMiss::default() }.feasible(&scene, &[0, 1]).is_empty()
}

#[test]
fn brakes_that_build_up_are_pressed_early_enough() {
    assert_eq!([6.0, 7.0, 8.0, 9.0].map(|mps| comes_close([mps, 1.0], 17.5, true)), [true; 4]);
}

#[test]
fn whose_sizes_are_not_recorded_are_kept_as_far_apart_as_templates_have_to() {
    assert_eq!([9.0, 9.5, 10.0].map(|mps| comes_close([mps, 0.0], 20.0, false)), [true; 3]);
}

#[test]
fn who_cannot_meet_has_none() {
    let with = |other: Drive| outcomes(&scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), other])).len();
    assert_eq!(with(Drive::straight(60.0, 0.0, 0.0, 20.0)), 0);
    assert_eq!(with(Drive::straight(0.0, 3.5, 0.0, 10.0)), 0);
    assert_eq!(with(Drive::straight(20.0, 30.0, FRAC_PI_2, 10.0)), 0);
    // Two agents that close in on each other by 3 m/s at most stop in good time, or do not stop at all.
    assert_eq!(with(Drive::straight(10.0, 0.0, 0.0, 9.5)), 0);
}

#[test]
fn who_has_somebody_in_the_way_has_none() {
    let mut scene = toward_a_queue();
    let mut blocking = scene.tracks[1].clone();
    blocking.id = TrackId("9".to_owned());
    let nearer = |state: &Option<State>| state.map(|s| State { position: s.position - Vec2::new(12.0, 0.0), ..s });
    blocking.trajectory = Trajectory::new(blocking.trajectory.entries().iter().map(nearer).collect());
    scene.tracks.push(blocking);
    assert_eq!(outcomes(&scene), []);
    assert_eq!(NearMiss::default().template(&scene, &[0, 1], &BTreeMap::new(), 0), None);
}

#[test]
fn the_two_are_asked_for_as_events_name_them() {
    for behavior in [&NearMiss::default() as &dyn Behavior, &crate::behavior::Collision {}] {
        assert_eq!(behavior.completed(&crossing(), [0, 1]), Some(vec![0, 1]));
        assert_eq!(behavior.completed(&crossing(), [1, 0]), None);
    }
}
