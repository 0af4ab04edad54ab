//! Tests that concern every metric: hand-computed example scenes, independence of the frame, the recording as its own
//! sample.

use super::{ALL, Metric, ModesOf, SampleGroup, by_id, constant_velocity};
use crate::behavior::testing::{LaneSpec, SceneSpec, cases_in, random_scene, transformed};
use crate::geometry::{Transform2, Vec2};
use crate::scene::{Dataset, LaneGraph, Roles, Scene, State, Track, TrackId, TrackRole, Trajectory};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A recording with samples, and the expected figure; no `value` if the metric is undefined.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MetricCase {
    recorded: SceneSpec,
    #[serde(default)]
    samples: Vec<SceneSpec>,
    /// The probabilities of the samples, unless they are equally likely.
    probabilities: Option<Vec<f64>>,
    /// The requested agents, as [role, agent].
    #[serde(default)]
    asked: Vec<[String; 2]>,
    value: Option<f64>,
}

/// The figure with the first two agents requested as ego and other.
fn evaluate(metric: &dyn Metric, recorded: &Scene, samples: &[Scene]) -> Option<f64> {
    let roles = ["ego", "other"].into_iter().map(str::to_owned);
    let asked: Roles = roles.zip(recorded.tracks.iter().map(|track| track.id.clone())).collect();
    metric.evaluate(&SampleGroup { asked: &asked, ..SampleGroup::equally_likely(recorded, samples) })
}

#[test]
fn every_metric_gives_the_hand_computed_value_of_its_example_scenes() {
    for metric in ALL {
        let id = metric.spec().id;
        let cases = cases_in(&format!("metric/{id}"));
        assert!(!cases.is_empty(), "{id} has no example scene");
        for (name, text) in cases {
            let case: MetricCase = toml::from_str(&text).unwrap_or_else(|error| panic!("{id}/{name}: {error}"));
            let samples: Vec<Scene> = case.samples.iter().map(|sample| sample.build(&name)).collect();
            let recorded = &case.recorded.build(&name);
            let probabilities = case.probabilities.as_deref();
            let asked = case.asked.iter().map(|[role, agent]| (role.clone(), TrackId(agent.clone())));
            let asked: Roles = asked.collect();
            let group = SampleGroup { probabilities, asked: &asked, ..SampleGroup::equally_likely(recorded, &samples) };
            let value = metric.evaluate(&group);
            let agrees = match (value, case.value) {
                (Some(value), Some(expected)) => (value - expected).abs() < 1e-3,
                (value, expected) => value == expected,
            };
            assert!(agrees, "{id}/{name}: {value:?} instead of {:?}", case.value);
        }
    }
}

#[test]
fn metrics_are_listed_once_under_names_that_end_in_their_unit() {
    let ids: BTreeSet<&str> = ALL.iter().map(|metric| metric.spec().id).collect();
    assert_eq!(ids.len(), ALL.len());
    for metric in ALL {
        let spec = metric.spec();
        assert_eq!(spec.id.ends_with("_m"), spec.unit == "m", "{}", spec.id);
        assert_eq!(by_id(spec.id).map(|found| found.spec()), Some(spec));
    }
    assert!(by_id("no_such").is_none());
}

#[test]
fn figures_of_benchmarks_are_taken_over_modes_of_those_they_are_about() {
    let of = |wanted: ModesOf| -> BTreeSet<&str> {
        ALL.iter().filter(|metric| metric.spec().modes == Some(wanted)).map(|metric| metric.spec().id).collect()
    };
    let of_one = [
        "min_ade_m",
        "min_fde_m",
        "min_ade_of_min_fde_m",
        "miss_rate",
        "p_miss_rate",
        "p_min_ade_m",
        "p_min_fde_m",
        "brier_min_ade_m",
        "brier_min_fde_m",
        "drivable_area_compliance",
    ];
    let of_many = [
        "min_scene_ade_m",
        "min_scene_fde_m",
        "min_scene_ade_without_ego_m",
        "min_scene_fde_without_ego_m",
        "min_joint_ade_m",
        "min_joint_fde_m",
        "min_joint_miss_rate",
        "consistent_min_joint_miss_rate",
        "cross_collision_rate",
        "ego_collision_rate",
        "avg_min_ade_m",
        "avg_min_fde_m",
        "avg_brier_min_fde_m",
        "actor_miss_rate",
        "actor_collision_rate",
    ];
    assert_eq!(of(ModesOf::Ego), BTreeSet::from(of_one));
    assert_eq!(of(ModesOf::Scene), BTreeSet::from(of_many));
}

/// Random traffic on two lanes, one of them without boundaries.
fn scene_on_lanes(seed: u64) -> Scene {
    let lanes = r#"
        lanes = [
            { id = 1, centerline = [[-60, 0], [0, 0], [60, 6]], width_m = 12.0 },
            { id = 2, centerline = [[0, -60], [0, 60]] },
        ]"#;
    #[derive(Deserialize)]
    struct Lanes {
        lanes: Vec<LaneSpec>,
    }
    let lanes: Lanes = toml::from_str(lanes).expect("valid");
    let lanes = LaneGraph::new(lanes.lanes.iter().map(LaneSpec::build).collect());
    Scene { lanes: Arc::new(lanes), ..random_scene(seed, 9, 25.0) }
}

/// The scene with every future state off by an amount that grows with time and is different for every agent.
fn drifted(scene: &Scene, drift_mps: f64) -> Scene {
    let track = |(agent_idx, track): (usize, &Track)| {
        let direction = Vec2::from_angle(agent_idx as f64);
        let state = |(timestep, state): (usize, &Option<State>)| {
            let elapsed_s = timestep.saturating_sub(scene.current_timestep()) as f64 * scene.dt_s;
            state.map(|s| State { position: s.position + direction * (drift_mps * elapsed_s), ..s })
        };
        let states = track.trajectory.entries().iter().enumerate().map(state);
        Track { trajectory: Trajectory::new(states.collect()), ..track.clone() }
    };
    Scene { tracks: scene.tracks.iter().enumerate().map(track).collect(), ..scene.clone() }
}

#[test]
fn a_recording_is_no_distance_from_itself() {
    for seed in 0..20 {
        let scene = random_scene(seed, 9, 25.0);
        // Distances between samples, and between agents, are not distances from the recording.
        let is_distance = |metric: &&&dyn Metric| {
            metric.spec().unit == "m" && !["mfd_m", "pair_min_distance_m"].contains(&metric.spec().id)
        };
        for metric in ALL.iter().filter(is_distance) {
            let value = evaluate(*metric, &scene, std::slice::from_ref(&scene));
            assert!(value.is_none_or(|value| value == 0.0), "{}: {value:?}", metric.spec().id);
        }
    }
}

#[test]
fn more_samples_never_make_the_best_one_worse() {
    let scene = random_scene(3, 9, 25.0);
    let samples = [drifted(&scene, 3.0), drifted(&scene, 1.0), drifted(&scene, 2.0)];
    for metric in ALL.iter().filter(|metric| metric.spec().id.starts_with("min_") && metric.spec().unit == "m") {
        let [one, all] = [&samples[..1], &samples[..]].map(|samples| evaluate(*metric, &scene, samples));
        let (one, all) = one.zip(all).expect("the ego is recorded throughout");
        // A drift of 1 m/s is a third of one of 3 m/s.
        assert!((one / all - 3.0).abs() < 1e-9, "{}: {one} and {all}", metric.spec().id);
    }
}

#[test]
fn without_samples_or_future_nothing_is_defined() {
    let scene = random_scene(3, 9, 25.0);
    let history = Scene {
        n_timesteps: scene.n_history,
        tracks: scene
            .tracks
            .iter()
            .map(|track| Track {
                trajectory: Trajectory::new(track.trajectory.entries()[..scene.n_history].to_vec()),
                ..track.clone()
            })
            .collect(),
        ..scene.clone()
    };
    for metric in ALL {
        assert_eq!(evaluate(*metric, &scene, &[]), None, "{}", metric.spec().id);
        let samples = [history.clone(), history.clone()];
        assert_eq!(evaluate(*metric, &history, &samples), None, "{}", metric.spec().id);
    }
}

#[test]
fn a_sample_that_lacks_states_is_not_scored() {
    let scene = random_scene(3, 9, 25.0);
    let mut sample = scene.clone();
    let states: Vec<Option<State>> =
        scene.ego().trajectory.entries().iter().enumerate().map(|(t, state)| state.filter(|_| t < 25)).collect();
    sample.tracks[scene.ego_idx].trajectory = Trajectory::new(states);
    for id in ["min_ade_m", "min_fde_m", "miss_rate", "min_scene_ade_m", "min_scene_fde_m"] {
        let metric = by_id(id).expect("listed");
        assert_eq!(evaluate(metric, &scene, &[scene.clone(), sample.clone()]), None, "{id}");
    }
}

#[test]
fn constant_velocity_goes_straight_on_from_the_present() {
    let scene = random_scene(5, 9, 25.0);
    let baseline = constant_velocity(&scene);
    let present = scene.current_timestep();
    for (track, recorded) in baseline.tracks.iter().zip(&scene.tracks) {
        assert_eq!(track.trajectory.n_timesteps(), scene.n_timesteps);
        assert_eq!(track.trajectory.entries()[..scene.n_history], recorded.trajectory.entries()[..scene.n_history]);
        let Some(now) = recorded.trajectory.get(present) else {
            assert!(track.trajectory.entries()[scene.n_history..].iter().all(Option::is_none));
            continue;
        };
        // 30 timesteps of 0.1 s are 3 s.
        let last = track.trajectory.get(scene.n_timesteps - 1).expect("extrapolated");
        assert!(last.position.distance(now.position + now.velocity * 3.0) < 1e-9);
        assert_eq!((last.velocity, last.heading_rad), (now.velocity, now.heading_rad));
    }
}

proptest! {
    // Fixed seed: every run has the same cases.
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(7), ..ProptestConfig::with_cases(40) })]
    #[test]
    fn the_frame_does_not_matter(seed in 0..10_000u64, x in -1e3..1e3f64, y in -1e3..1e3f64, angle in -3.0..3.0f64) {
        let mut scene = scene_on_lanes(seed);
        // Figures of one benchmark are defined on scenes of its dataset only.
        scene.source.dataset = Dataset::ALL[seed as usize % Dataset::ALL.len()];
        for track in scene.tracks.iter_mut().step_by(2) {
            track.role = TrackRole::Scored;
        }
        let samples = [constant_velocity(&scene), drifted(&scene, 2.0)];
        let moved_by = Transform2::from_pose(Vec2::new(x, y), angle);
        let moved_samples = samples.each_ref().map(|sample| transformed(sample, &moved_by));
        for metric in ALL {
            let value = evaluate(*metric, &scene, &samples);
            let moved = evaluate(*metric, &transformed(&scene, &moved_by), &moved_samples);
            let agrees = match (value, moved) {
                (Some(value), Some(moved)) => (value - moved).abs() < 1e-6,
                (value, moved) => value == moved,
            };
            prop_assert!(agrees, "{}: {value:?} and {moved:?}", metric.spec().id);
        }
    }
}
