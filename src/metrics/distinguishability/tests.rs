//! Features have the values of closed forms, and the test finds differences that exist and no others.

use super::*;
use crate::geometry::{Transform2, Vec2};
use crate::scene::testing::{self, Drive};
use crate::scene::{AgentClass, Scene, State, Trajectory};
use crate::seed::{Seed, SeededRng};

const N_TIMESTEPS: usize = 24;
const N_HISTORY: usize = 4;

/// A scene of vehicles in these poses, x and y in meters, heading in radians.
fn scene_of(poses: &[&dyn Fn(usize) -> [f64; 3]]) -> Scene {
    let mut scene = testing::scene(&vec![Drive::straight(0.0, 0.0, 0.0, 1.0); poses.len()]);
    scene.n_timesteps = N_TIMESTEPS;
    for (track, poses) in scene.tracks.iter_mut().zip(poses) {
        let state = |timestep| {
            let [x, y, heading_rad] = poses(timestep);
            // A wrong velocity, which nothing may read.
            Some(State { position: Vec2::new(x, y), heading_rad, velocity: Vec2::new(99.0, 99.0) })
        };
        track.trajectory = Trajectory::new((0..N_TIMESTEPS).map(state).collect());
    }
    scene
}

fn named(found: &TrackFeatures, name: &str) -> f64 {
    let idx = features().iter().position(|feature| feature.name == name);
    found.get(idx.unwrap_or_else(|| panic!("no feature {name}")))
}

fn assert_all(found: &TrackFeatures, expected: &[(&str, f64)]) {
    for (name, expected) in expected {
        let found = named(found, name);
        assert!((found - expected).abs() < 1e-4, "{name} is {found}, not {expected}");
    }
}

/// x in meters along a lane at y = 0 with a jerk of 6 m/s³: whole millimeters at every timestep of .1 s.
fn cubic(timestep: usize) -> f64 {
    let k = timestep as f64;
    -30.0 + k + 0.01 * k.powi(2) + 0.001 * k.powi(3)
}

fn on_the_lane(timestep: usize) -> [f64; 3] {
    [cubic(timestep), 0.0, 0.0]
}

#[test]
fn features_of_a_constant_jerk_are_its_derivatives() {
    let scene = scene_of(&[&|k| [cubic(k), 1.2, 0.0], &|k| [cubic(k), 4.7, 0.0], &|_| [-30.0, 80.0, 0.0]]);
    // The second difference at timestep m is 2 + .6 m. Of the future, accelerations begin two timesteps after the
    // present, at which all three positions are of the future.
    let x = cubic;
    let last = N_TIMESTEPS - 1;
    let half_second = |from: usize| (x(from + 5) - x(from)) / 0.5;
    let expected = [
        ("speed_min", (x(5) - x(4)) / 0.1),
        ("speed_max", (x(last) - x(last - 1)) / 0.1),
        ("acc_long_min", 5.0),
        ("acc_long_q50", 2.0 + 0.6 * 13.5),
        ("acc_long_max", 2.0 + 0.6 * 22.0),
        ("acc_lat_max", 0.0),
        ("jerk_q10", 6.0),
        ("jerk_max", 6.0),
        ("yaw_rate_max", 0.0),
        ("slip_max", 0.0),
        ("seam_acc_long", 3.8),
        ("seam_jerk_long", 6.0),
        ("seam_jerk0_long", 6.0),
        ("seam_jerk_norm", 6.0),
        ("seam_acc_change", 1.2),
        ("lane_q50", 1.2),
        ("lane_change", 0.0),
        ("lane_dh_max", 0.0),
        ("gap_min", 3.5 - 1.8),
        ("dx", x(last) - x(3)),
        ("dy", 0.0),
        ("speed_now", (x(3) - x(2)) / 0.1),
        ("stop_share", 0.0),
        ("half_second_speed_min", half_second(3)),
        ("half_second_speed_last", half_second(18)),
        ("half_second_acc_min", (half_second(8) - half_second(3)) / 0.5),
        ("half_second_jerk_max", 6.0),
        // Quadratics over a symmetric window keep cubics as they are.
        ("smoothed_jerk_q50", 6.0),
        // The first quadratic is all that is known up to timestep 3: at 2, it is 6 mm short of the cubic.
        ("smoothed_seam_acc", 3.2),
    ];
    assert_all(&Surroundings::new(&scene).features_of(0), &expected);

    // In another frame, everything is the same.
    let frame = Transform2::from_pose(Vec2::new(1000.0, -500.0), 0.5);
    let moved = Scene {
        tracks: scene
            .tracks
            .iter()
            .map(|track| crate::scene::Track { trajectory: track.trajectory.transformed(&frame), ..track.clone() })
            .collect(),
        lanes: std::sync::Arc::new(scene.lanes.transformed(&frame)),
        world_from_scene: frame.inverse(),
        ..scene
    };
    assert_all(&Surroundings::new(&moved).features_of(0), &expected);
}

#[test]
fn who_turns_where_it_stands_has_a_yaw_rate_and_nothing_else() {
    let turning = |from: f64, k: usize| [3.0, 0.4, crate::geometry::wrap_angle(from + 0.02 * k as f64)];
    let scene = scene_of(&[&|k| turning(1.1, k), &|k| turning(3.0, k)]);
    let around = Surroundings::new(&scene);
    // Half a turn is no whole number of milliradians.
    assert!((named(&around.features_of(1), "yaw_rate_max") - 0.2).abs() < 0.01);
    let found = around.features_of(0);
    assert_all(
        &found,
        &[
            ("yaw_rate_min", 0.2),
            ("yaw_rate_max", 0.2),
            ("yaw_acc_max", 0.0),
            ("seam_turn", 0.2),
            ("seam_turn_jump", 0.0),
            ("dh", 0.4),
            ("stop_share", 1.0),
            ("exactly_still", 1.0),
            ("slip_max", 0.0),
            ("half_second_yaw_rate_max", 0.2),
            ("half_second_yaw_rate_std", 0.0),
            ("lane_max", 0.4),
            ("lane_dh_max", 1.1 + 0.02 * 23.0),
            ("gap_min", 0.0),
        ],
    );
}

#[test]
fn curves_have_lateral_acceleration_and_a_lane_left_has_a_distance() {
    // A quarter of .5 m/s² to the left, at 10 m/s: y = .25 t².
    let scene = scene_of(&[&|k| [k as f64 - 20.0, 0.002_5 * (k as f64).powi(2), 0.0]]);
    let last = (N_TIMESTEPS - 1) as f64;
    let side = |k: f64| 0.002_5 * k * k;
    // Steps of .5 s: the angle between the last two velocities.
    let angle = |k: f64| ((side(k + 5.0) - side(k)) / 5.0).atan();
    let speed = ((side(13.0) - side(8.0)).powi(2) + 25.0_f64).sqrt() / 0.5;
    let found = Surroundings::new(&scene).features_of(0);
    let slip = ((side(last) - side(last - 1.0)) / 1.0).atan();
    let tolerance = 0.06;
    for (name, expected) in [("smoothed_acc_lat_q50", 0.5), ("lane_last", side(last)), ("slip_max", slip)] {
        assert!((named(&found, name) - expected).abs() < tolerance, "{name}");
    }
    let lateral = named(&found, "half_second_acc_lat_max");
    assert!((lateral - speed * (angle(13.0) - angle(8.0)) / 0.5).abs() < 0.03, "{lateral}");
}

#[test]
fn tracks_are_judged_that_move_by_themselves_and_last() {
    let mut scene = scene_of(&[&on_the_lane, &on_the_lane, &on_the_lane, &on_the_lane]);
    scene.tracks[1].class = AgentClass::Pedestrian;
    scene.tracks[2].class = AgentClass::Unknown;
    let mut states = scene.tracks[3].trajectory.entries().to_vec();
    states[N_TIMESTEPS - 1] = None;
    scene.tracks[3].trajectory = Trajectory::new(states);
    // Seen only from two timesteps before the present: enough.
    let mut states = scene.tracks[0].trajectory.entries().to_vec();
    states[0] = None;
    scene.tracks[0].trajectory = Trajectory::new(states);
    let around = Surroundings::new(&scene);
    assert_eq!([0, 1, 2, 3].map(|track| around.is_judged(track)), [true, false, true, false]);
    assert_all(&around.features_of(0), &[("seam_jerk0_long", 6.0), ("jerk_max", 6.0), ("smoothed_jerk_q50", 6.0)]);
}

#[test]
fn without_lanes_or_past_what_needs_them_is_missing() {
    let mut scene = scene_of(&[&on_the_lane]);
    scene.lanes = std::sync::Arc::default();
    scene.n_history = 1;
    let found = Surroundings::new(&scene).features_of(0);
    for name in ["lane_q50", "lane_change", "seam_acc_long", "seam_turn_jump", "speed_now", "smoothed_seam_acc"] {
        assert!(named(&found, name).is_nan(), "{name}");
    }
    assert_all(&found, &[("jerk_max", 6.0), ("gap_min", 30.0)]);
}

#[test]
fn sets_share_out_the_features() {
    let of = |set: FeatureSet| set.indices().len();
    assert_eq!(FeatureSet::ALL.map(of), [88, 42, 16, 12, 10]);
    assert_eq!(features().iter().filter(|feature| feature.name.is_empty()).count(), 0);
}

/// Vehicles that speed up, slow down and sway, each in its own way; `noise_m` is added to every position of the future.
fn future(rng: &mut SeededRng, noise_m: f64) -> Scene {
    let mut drive = || {
        let (speed, sway, phase) = (4.0 + 8.0 * rng.uniform(), rng.uniform(), 6.0 * rng.uniform());
        let noise: Vec<f64> = (0..2 * N_TIMESTEPS).map(|_| noise_m * rng.normal()).collect();
        move |k: usize| {
            let t = k as f64 * 0.1;
            let jitter = if k < N_HISTORY { [0.0; 2] } else { [noise[2 * k], noise[2 * k + 1]] };
            let (along, across) = ((2.0 * t + phase).sin(), 0.3 * (1.5 * t + phase).cos());
            [speed * t + sway * along + jitter[0], sway * across + jitter[1], 0.0]
        }
    };
    let drives = [drive(), drive(), drive(), drive()];
    scene_of(&drives.iter().map(|drive| drive as &dyn Fn(usize) -> [f64; 3]).collect::<Vec<_>>())
}

/// Pairs of two futures of 40 scenes, the second of which has noise.
fn pairs(noise_m: f64) -> Vec<TrackPair> {
    let mut rng = Seed(4).rng();
    let of_scene = |scene: usize| {
        let [recorded, generated] = [0.0, noise_m].map(|noise_m| future(&mut rng, noise_m));
        let of = |scene: &Scene, track: usize| Surroundings::new(scene).features_of(track);
        let pair = |track| TrackPair { scene, recorded: of(&recorded, track), generated: of(&generated, track) };
        (0..4).map(pair).collect::<Vec<_>>()
    };
    (0..40).flat_map(of_scene).collect()
}

#[test]
fn recorded_futures_cannot_be_told_from_recorded_ones() {
    let pairs = pairs(0.0);
    let test = TwoSampleTest::new(&pairs).expect("enough tracks");
    for found in &test.by_set {
        let Auc { value, interval: [low, high] } = found.tracks;
        assert!((value - 0.5).abs() < 0.06 && low <= 0.5 && 0.5 <= high, "{:?}: {:?}", found.set, found.tracks);
    }
}

#[test]
fn half_a_millimeter_of_noise_is_found_in_the_jerk_and_not_in_steps_of_half_a_second() {
    let pairs = pairs(0.000_5);
    let test = TwoSampleTest::new(&pairs).expect("enough tracks");
    let of = |set: FeatureSet| test.by_set.iter().find(|found| found.set == set).expect("an area").tracks.value;
    assert!(of(FeatureSet::All) > 0.85, "{}", of(FeatureSet::All));
    assert!(of(FeatureSet::HalfSeconds) < 0.6, "{}", of(FeatureSet::HalfSeconds));
    let features = features();
    let first = &test.telling[0];
    assert!(["jerk", "acc_lat"].iter().any(|name| features[first.feature].name.starts_with(name)), "{first:?}");
    assert_eq!(test.telling.len(), 5);

    // Scenes are easier to tell apart than their tracks, and look recorded if they are.
    let all = &test.by_set[0];
    assert!(all.scenes.expect("scenes").value >= all.tracks.value);
    let likeness = |of: fn(&TrackPair) -> &TrackFeatures| {
        let mean = |scene: usize| test.likeness(scene, pairs.iter().filter(|pair| pair.scene == scene).map(of));
        (0..40).filter_map(mean).sum::<f64>() / 40.0
    };
    let (recorded, generated) = (likeness(|pair| &pair.recorded), likeness(|pair| &pair.generated));
    assert!(recorded > 0.8 && generated < 0.2, "{recorded}, {generated}");
    assert_eq!(test.likeness(0, std::iter::empty()), None);
}

#[test]
fn the_result_does_not_depend_on_threads_and_needs_enough_tracks() {
    let pairs = pairs(0.000_5);
    let with = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        let test = pool.install(|| TwoSampleTest::new(&pairs)).expect("enough tracks");
        (test.by_set.clone(), test.telling.clone(), test.likeness(3, pairs.iter().map(|pair| &pair.generated)))
    };
    assert!(with(1) == with(2));
    assert!(TwoSampleTest::new(&pairs[..MIN_TRACKS - 1]).is_none());
    assert!(TwoSampleTest::new(&pairs[..16]).is_none(), "four scenes cannot be divided into five parts");
}
