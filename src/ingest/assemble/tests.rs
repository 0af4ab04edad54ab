//! Assembling scenes: ego, frame, caps and the crop of the map.

use super::*;
use crate::ingest::lane_topology::tests::lane;
use crate::ingest::test_data;
use crate::scene::testing;
use crate::scene::{Dataset, SceneId, Trajectory};
use proptest::prelude::*;

const N_TIMESTEPS: usize = 5;
const N_HISTORY: usize = 3;
const PRESENT: usize = N_HISTORY - 1;

/// A track at `position` that moves 1 m a timestep along `heading_rad`, tracked where `is_valid`.
fn track(id: &str, role: TrackRole, position: Vec2, heading_rad: f64, is_valid: impl Fn(usize) -> bool) -> Track {
    let states = (0..N_TIMESTEPS).map(|timestep| {
        let moved = Vec2::from_angle(heading_rad) * (timestep as f64 - PRESENT as f64);
        let velocity = Vec2::from_angle(heading_rad) * 10.0;
        is_valid(timestep).then_some(State { position: position + moved, heading_rad, velocity })
    });
    Track { role, extent: None, ..testing::vehicle(id, states) }
}

fn context(id: &str, x: f64, y: f64) -> Track {
    track(id, TrackRole::Context, Vec2::new(x, y), 0.3, |_| true)
}

fn raw(tracks: Vec<Track>) -> RawScene {
    let raw = test_data::raw(testing::scene(&[]));
    RawScene { n_timesteps: N_TIMESTEPS, n_history: N_HISTORY, tracks, ..raw }
}

fn config() -> IngestConfig {
    IngestConfig::new(Dataset::Interaction, vec!["x".into()])
}

fn ids(scene: &Scene) -> Vec<&str> {
    scene.tracks.iter().map(|track| track.id.0.as_str()).collect()
}

#[test]
fn the_focal_track_is_the_ego_if_it_is_there() {
    let focal = |is_valid: fn(usize) -> bool| track("f", TrackRole::Focal, Vec2::new(3.0, 4.0), 1.0, is_valid);
    let (scene, _) = assemble(raw(vec![context("a", 0.0, 0.0), focal(|_| true)]), None, &config()).expect("complete");
    assert_eq!(scene.ego().id.0, "f");
    assert!(scene.world_from_scene.translation.distance(Vec2::new(3.0, 4.0)) < 1e-12);
    let present = scene.state(scene.ego_idx, PRESENT).expect("the ego is present");
    assert!(present.position.norm() < 1e-12 && present.heading_rad.abs() < 1e-12);
    let (scene, counts) =
        assemble(raw(vec![context("a", 0.0, 0.0), focal(|t| t != PRESENT)]), None, &config()).expect("complete");
    assert_eq!((scene.ego().id.0.as_str(), ids(&scene)), ("a", vec!["a"]));
    assert_eq!(counts.dropped["agents_absent"], 1);
}

#[test]
fn without_a_focal_track_the_draw_depends_on_seed_and_scene_alone() {
    let tracks: Vec<Track> = (0..9).map(|i| context(&format!("t{i}"), i as f64 * 5.0, 0.0)).collect();
    let ego = |seed: u64, name: &str| {
        let scene = RawScene { id: SceneId::from(name), ..raw(tracks.clone()) };
        let config = IngestConfig { seed, ..config() };
        assemble(scene, None, &config).expect("complete").0.ego_idx
    };
    assert_eq!(ego(1, "a"), ego(1, "a"));
    let drawn: std::collections::BTreeSet<usize> = (0..60).map(|i| ego(1, &i.to_string())).collect();
    assert!(drawn.len() >= 8, "every vehicle may be drawn: {drawn:?}");
    assert!((0..20).any(|seed| ego(seed, "a") != ego(seed + 1, "a")));
}

#[test]
fn the_order_of_tracks_in_the_recording_does_not_choose_the_ego() {
    let tracks: Vec<Track> = (1..=12).map(|id| context(&id.to_string(), 10.0 * f64::from(id), 0.0)).collect();
    for seed in 0..20 {
        let config = IngestConfig { seed, ..config() };
        let ego = |tracks: Vec<Track>| assemble(raw(tracks), None, &config).expect("complete").0.ego().id.0.clone();
        let reversed: Vec<Track> = tracks.iter().rev().cloned().collect();
        assert_eq!(ego(tracks.clone()), ego(reversed));
    }
}

#[test]
fn whole_tracks_are_preferred_as_ego_and_pedestrians_never_drawn() {
    let partial = track("p", TrackRole::Context, Vec2::ZERO, 0.0, |t| t >= PRESENT);
    let pedestrian = Track { class: AgentClass::Pedestrian, ..context("w", 1.0, 1.0) };
    for seed in 0..10 {
        let config = IngestConfig { seed, ..config() };
        let ego = |tracks| assemble(raw(tracks), None, &config).map(|(scene, _)| scene.ego().id.0.clone());
        assert_eq!(ego(vec![partial.clone(), pedestrian.clone(), context("a", 9.0, 0.0)]), Ok("a".to_owned()));
        assert_eq!(ego(vec![partial.clone(), pedestrian.clone()]), Ok("p".to_owned()));
        assert_eq!(ego(vec![pedestrian.clone()]).expect_err("nobody drives").reason, "no_ego");
    }
}

#[test]
fn the_cap_keeps_the_nearest_with_ties_by_id() {
    let focal = track("f", TrackRole::Focal, Vec2::ZERO, 0.0, |_| true);
    let tracks = vec![context("far", 50.0, 0.0), context("b", 0.0, 2.0), focal, context("a", 0.0, -2.0)];
    let kept = |max_agents| {
        let config = IngestConfig { max_agents, ..config() };
        let (scene, counts) = assemble(raw(tracks.clone()), None, &config).expect("complete");
        assert_eq!(scene.ego().id.0, "f");
        let names: Vec<String> = ids(&scene).into_iter().map(str::to_owned).collect();
        (names.join(" "), counts.dropped.get("agents_over_cap").copied().unwrap_or(0))
    };
    assert_eq!(kept(4), ("far b f a".to_owned(), 0));
    assert_eq!(kept(3), ("b f a".to_owned(), 1));
    assert_eq!(kept(2), ("f a".to_owned(), 2));
    assert_eq!(kept(1), ("f".to_owned(), 3));
}

#[test]
fn parked_vehicles_are_there_if_there_is_room_but_never_the_ego_of_traffic() {
    let parked = |id: &str, x: f64| track(id, TrackRole::Parked, Vec2::new(x, 0.0), 0.0, |_| true);
    let late = track("late", TrackRole::Context, Vec2::new(40.0, 0.0), 0.0, |t| t >= PRESENT);
    let tracks = vec![parked("p", 1.0), parked("q", 2.0), late, parked("r", 41.0)];
    for seed in 0..10 {
        let config = IngestConfig { seed, max_agents: 2, ..config() };
        let (scene, counts) = assemble(raw(tracks.clone()), None, &config).expect("complete");
        assert_eq!((scene.ego().id.0.as_str(), ids(&scene)), ("late", vec!["late", "r"]));
        assert_eq!((counts.dropped["agents_over_cap"], counts.assumed["vehicles_parked"]), (2, 1));
        let walker = Track { class: AgentClass::Pedestrian, ..context("w", 1.0, 1.0) };
        let config = IngestConfig { max_agents: 1, ..config };
        let (scene, _) = assemble(raw(vec![parked("p", 1.0), walker]), None, &config).expect("complete");
        assert_eq!(ids(&scene), ["p"], "of nobody else, it is the ego");
    }
}

#[test]
fn who_is_not_there_at_present_and_static_objects_are_left_out() {
    let gone = track("gone", TrackRole::Context, Vec2::ZERO, 0.0, |t| t < PRESENT);
    let later = track("later", TrackRole::Context, Vec2::new(9.0, 0.0), 0.0, |t| t > PRESENT);
    let cone = Track { class: AgentClass::Static, ..context("cone", 1.0, 0.0) };
    let tracks = vec![context("a", 0.0, 0.0), gone, later, cone];
    let (scene, counts) = assemble(raw(tracks), None, &config()).expect("complete");
    assert_eq!(ids(&scene), ["a"]);
    assert_eq!((counts.dropped["agents_absent"], counts.dropped["agents_static"]), (2, 1));
}

#[test]
fn lanes_are_cropped_and_required() {
    let lanes =
        vec![lane(1, (0.0, 0.0), (10.0, 0.0)), lane(2, (10.0, 0.0), (500.0, 0.0)), lane(3, (300.0, 9.0), (400.0, 9.0))];
    let index = LaneIndex::new(Arc::new(LaneGraph::new(lanes)));
    let focal = |x| vec![track("f", TrackRole::Focal, Vec2::new(x, 0.0), 0.0, |_| true)];
    let (scene, _) = assemble(raw(focal(0.0)), Some(&index), &config()).expect("complete");
    assert_eq!(scene.lanes.lanes().iter().map(|lane| lane.id.0).collect::<Vec<_>>(), [1, 2]);
    assert_eq!(scene.map_id, Some("Test".into()));
    let (scene, _) = assemble(raw(focal(290.0)), Some(&index), &config()).expect("complete");
    assert_eq!(scene.lanes.lanes()[0].centerline.0[0], Vec2::new(-280.0, 0.0), "lanes are in the scene frame");
    let reject = assemble(raw(focal(700.0)), Some(&index), &config()).expect_err("far from every lane");
    assert_eq!(reject.reason, "no_lanes_in_radius");
    let (scene, _) = assemble(raw(focal(700.0)), None, &config()).expect("no map is needed");
    assert!(scene.lanes.is_empty() && scene.map_id.is_none());
}

#[test]
fn lanes_that_anybody_can_reach_belong_to_the_scene() {
    let lanes = vec![lane(1, (0.0, 0.0), (10.0, 0.0)), lane(3, (300.0, 9.0), (400.0, 9.0))];
    let index = LaneIndex::new(Arc::new(LaneGraph::new(lanes)));
    let ids = |far: Track, max_agents: usize| {
        let focal = track("f", TrackRole::Focal, Vec2::ZERO, 0.0, |_| true);
        let config = IngestConfig { max_agents, ..config() };
        let (scene, _) = assemble(raw(vec![focal, far]), Some(&index), &config).expect("complete");
        scene.lanes.lanes().iter().map(|lane| lane.id.0).collect::<Vec<_>>()
    };
    // At 10 m/s and 5 m/s² the far agent gets 2.1 m in the two timesteps to come, and 10 m are around it: the lane is
    // at 10.3 and at 13.5 m.
    assert_eq!(ids(context("far", 295.0, 0.0), 2), [1, 3]);
    assert_eq!(ids(context("far", 290.0, 0.0), 2), [1]);
    assert_eq!(ids(context("far", 295.0, 0.0), 1), [1], "who does not take part counts for nothing");
    // Its motion after the present has no effect.
    let jumps = |timestep: usize| if timestep > PRESENT { 5.0 } else { 0.0 };
    let mut far = context("far", 290.0, 0.0);
    let moved = far
        .trajectory
        .valid()
        .map(|(timestep, state)| Some(State { position: state.position + Vec2::new(jumps(timestep), 0.0), ..*state }));
    far.trajectory = Trajectory::new(moved.collect());
    assert_eq!(ids(far, 2), [1]);
}

#[test]
fn standing_tracks_take_the_direction_of_their_lane() {
    let index = LaneIndex::new(Arc::new(LaneGraph::new(vec![lane(1, (0.0, 0.0), (0.0, 90.0))])));
    let parked = |x| track("parked", TrackRole::Focal, Vec2::new(x, 10.0), 0.0, |_| true);
    let heading = |x| {
        let heading_gaps = vec![HeadingGap { track_idx: 0, until_timestep: 4, never_moves: None }];
        let (scene, counts) =
            assemble(RawScene { heading_gaps, ..raw(vec![parked(x)]) }, Some(&index), &config()).expect("complete");
        let headings: Vec<f64> = scene.tracks[0].trajectory.valid().map(|(_, state)| state.heading_rad).collect();
        (scene.world_from_scene.rotation_rad(), headings[0], headings[4], counts.assumed)
    };
    let (world, first, last, assumed) = heading(4.0);
    assert!((world - std::f64::consts::FRAC_PI_2).abs() < 1e-12 && first.abs() < 1e-12);
    assert!((last + std::f64::consts::FRAC_PI_2).abs() < 1e-12, "known headings stay");
    assert_eq!(assumed["headings_from_lanes"], 1);
    let (world, _, _, assumed) = heading(6.0);
    assert_eq!((world, assumed["headings_unknown"]), (0.0, 1));
}

#[test]
fn who_never_moves_takes_the_direction_of_the_lane_it_stands_on() {
    // A lane north, and one south beside it. The front is recorded, 2 m ahead of the center.
    let lanes = vec![lane(1, (0.0, 0.0), (0.0, 90.0)), lane(2, (-3.5, 90.0), (-3.5, 0.0))];
    let index = LaneIndex::new(Arc::new(LaneGraph::new(lanes)));
    let parked = |x| track("parked", TrackRole::Focal, Vec2::new(x, 10.0), 0.0, |_| true);
    let assembled = |x: f64| {
        let heading_gaps = vec![HeadingGap { track_idx: 0, until_timestep: 5, never_moves: Some(-2.0) }];
        let raw = RawScene { heading_gaps, ..raw(vec![parked(x)]) };
        let (scene, counts) = assemble(raw, Some(&index), &config()).expect("complete");
        (scene.world_from_scene, counts)
    };
    let (world, counts) = assembled(0.5);
    assert!((world.rotation_rad() - std::f64::consts::FRAC_PI_2).abs() < 1e-12, "{world:?}");
    assert!(world.point(Vec2::ZERO).distance(Vec2::new(0.5, 8.0)) < 1e-12, "{world:?}");
    assert_eq!(counts.assumed["headings_from_lanes"], 1);
    // Between both, and beside them.
    for x in [-1.75, 2.5] {
        let (world, counts) = assembled(x);
        assert_eq!((world.rotation_rad(), world.point(Vec2::ZERO)), (0.0, Vec2::new(x, 10.0)));
        let said = &counts.warnings["headings_unknown"];
        assert!(said.count == 1 && said.examples[0].contains("track parked never moves"), "{said:?}");
    }
}

#[test]
fn states_that_are_not_finite_are_rejected() {
    let mut bad = raw(vec![context("a", f64::NAN, 0.0)]);
    bad.tracks.push(context("b", 0.0, 0.0));
    assert_eq!(assemble(bad, None, &config()).expect_err("not finite").reason, "non_finite");
}

proptest! {
    #[test]
    fn scene_states_map_back_to_recorded_coordinates(
        x in -1e5..1e5f64, y in -1e5..1e5f64, heading in -3.1..3.1f64,
        others in prop::collection::vec((-200.0..200.0f64, -200.0..200.0f64, -3.1..3.1f64), 0..6),
    ) {
        let mut tracks = vec![track("f", TrackRole::Focal, Vec2::new(x, y), heading, |_| true)];
        tracks.extend(others.iter().enumerate().map(|(i, (dx, dy, h))| {
            track(&i.to_string(), TrackRole::Context, Vec2::new(x + dx, y + dy), *h, |_| true)
        }));
        let (scene, _) = assemble(raw(tracks.clone()), None, &config()).expect("complete");
        for (recorded, kept) in tracks.iter().zip(&scene.tracks) {
            let back = kept.trajectory.transformed(&scene.world_from_scene);
            for ((_, recorded), (_, back)) in recorded.trajectory.valid().zip(back.valid()) {
                prop_assert!(recorded.position.distance(back.position) < 1e-6);
                prop_assert!(recorded.velocity.distance(back.velocity) < 1e-6);
                prop_assert!(crate::geometry::angle_difference(recorded.heading_rad, back.heading_rad).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn impossible_states_are_rejected_before_they_are_stored() {
    // Single precision holds neither; the first would be stored unchanged, the second would become infinite.
    for (x, reason) in [(1e8, "out_of_range"), (1e39, "out_of_range"), (f64::INFINITY, "non_finite")] {
        let reject = assemble(raw(vec![context("a", 0.0, 0.0), context("b", x, 0.0)]), None, &config()).unwrap_err();
        assert_eq!(reject.reason, reason);
        assert!(reject.detail.contains("Test_train.csv") && reject.detail.contains("track b"), "{}", reject.detail);
    }
    let mut fast = context("b", 5.0, 0.0);
    let entries = fast
        .trajectory
        .entries()
        .iter()
        .map(|state| state.map(|state| State { velocity: Vec2::new(1e30, 0.0), ..state }));
    fast.trajectory = Trajectory::new(entries.collect());
    let reject = assemble(raw(vec![context("a", 0.0, 0.0), fast]), None, &config()).unwrap_err();
    assert_eq!(reject.reason, "out_of_range");
}

#[test]
fn velocities_follow_from_positions_whatever_the_columns_say() {
    // Columns that are turned by three degrees, like those of a filter.
    let turned = |track: Track| {
        let turn = |state: &State| State { velocity: state.velocity.rotated(3f64.to_radians()), ..*state };
        let states = track.trajectory.entries().iter().map(|state| state.as_ref().map(turn)).collect();
        Track { trajectory: Trajectory::new(states), ..track }
    };
    let assembled = |tracks: Vec<Track>| assemble(raw(tracks), None, &config()).unwrap();
    let (expected, counts) = assembled(vec![context("1", 0.0, 0.0), context("2", 9.0, 0.0)]);
    assert!(!counts.assumed.contains_key("tracks_whose_recorded_velocities_disagree_with_positions"));
    let (scene, counts) = assembled(vec![turned(context("1", 0.0, 0.0)), context("2", 9.0, 0.0)]);
    assert_eq!(counts.assumed["tracks_whose_recorded_velocities_disagree_with_positions"], 1);
    assert_eq!(counts.assumed["tracks_with_velocities_from_positions"], 2);
    for (found, expected) in scene.tracks.iter().zip(&expected.tracks) {
        for ((_, found), (_, expected)) in found.trajectory.valid().zip(expected.trajectory.valid()) {
            assert!(found.velocity.distance(expected.velocity) < 1e-9, "{found:?}, expected {expected:?}");
        }
    }
    // Argoverse 1 records none, so the ones that its reader derived stay.
    let mut own = raw(vec![turned(context("1", 0.0, 0.0))]);
    own.source.dataset = Dataset::Argoverse1;
    let (scene, _) = assemble(own, None, &config()).unwrap();
    assert!((scene.state(0, PRESENT).unwrap().velocity.angle() - 3f64.to_radians()).abs() < 1e-9);
}

#[test]
fn who_is_of_no_type_is_left_out_where_types_are_recorded() {
    let nobody = || Track { class: AgentClass::Unknown, ..context("1", 3.0, 0.0) };
    let (scene, counts) = assemble(raw(vec![nobody(), context("2", 9.0, 0.0)]), None, &config()).unwrap();
    assert_eq!((ids(&scene), counts.dropped["agents_of_unknown_type"]), (vec!["2"], 1));
    let mut without_types = raw(vec![nobody()]);
    without_types.source.dataset = Dataset::Argoverse1;
    assert_eq!(ids(&assemble(without_types, None, &config()).unwrap().0), ["1"]);
}
