//! Closed forms: head-on, following, crossing, side by side, standing, overlapping; and the quick search against all
//! pairs.

use super::closing::MAX_DRAC_MPS2;
use super::*;
use crate::behavior::testing::{SceneSpec, random_scene};
use crate::metrics::{Metric, SampleGroup};
use crate::scene::Roles;

/// Cars of 4.5 by 1.8 m, as (x, y, heading in degrees, speed); 10 observed and 30 future timesteps of 0.1 s.
fn scene(cars: &[[f64; 4]]) -> Scene {
    let agent = |(idx, [x, y, heading, speed]): (usize, &[f64; 4])| {
        format!(
            "{{ id = \"{idx}\", start = {{ x_m = {x:?}, y_m = {y:?}, heading_deg = {heading:?}, \
             speed_mps = {speed:?} }} }}"
        )
    };
    let agents: Vec<String> = cars.iter().enumerate().map(agent).collect();
    let spec: SceneSpec = toml::from_str(&format!("agents = [{}]", agents.join(", "))).expect("valid");
    spec.build("cars")
}

fn pair(cars: [[f64; 4]; 2]) -> PairCriticality {
    let forth = PairCriticality::of(&scene(&cars), [0, 1]).expect("tracked together");
    let [first, second] = cars;
    let back = PairCriticality::of(&scene(&[second, first]), [0, 1]).expect("tracked together");
    assert!(near(forth.min_ttc_s, back.min_ttc_s), "the order of the two does not matter");
    assert!(near(forth.pet_s, back.pet_s), "the order of the two does not matter");
    forth
}

fn near(found: Option<f64>, expected: Option<f64>) -> bool {
    match (found, expected) {
        (Some(found), Some(expected)) => (found - expected).abs() < 1e-6,
        (found, expected) => found == expected,
    }
}

#[test]
fn head_on() {
    // After 3.9 s 100 - 39 - 19.5 m between centers, a length less between bumpers, closed at 15 m/s.
    let found = pair([[0.0, 0.0, 0.0, 10.0], [100.0, 0.0, 180.0, 5.0]]);
    assert!((found.min_distance_m - 37.0).abs() < 1e-6);
    assert!(near(found.min_ttc_s, Some(37.0 / 15.0)));
    assert!((found.max_drac_mps2 - 15.0 * 15.0 / (2.0 * 37.0)).abs() < 1e-6);
    assert_eq!((found.min_headway_s, found.pet_s, found.tet_s), (None, None, 0.0));
}

#[test]
fn following_at_constant_speeds() {
    // The gap is 25.7 m - 5 m/s t: 7.2, 6.7 and 6.2 m at the last three timesteps, TTC 1.44, 1.34 and 1.24 s.
    let found = pair([[0.0, 0.0, 0.0, 15.0], [30.2, 0.0, 0.0, 10.0]]);
    assert!(near(found.min_ttc_s, Some(1.24)));
    assert!((found.max_drac_mps2 - 25.0 / (2.0 * 6.2)).abs() < 1e-6);
    assert!((found.tet_s - 0.3).abs() < 1e-9 && (found.tit_s2 - 0.1 * (0.06 + 0.16 + 0.26)).abs() < 1e-6);
    assert!(near(found.min_headway_s, Some(6.2 / 15.0)));
    assert_eq!(found.pet_s, None, "who follows never leaves the common path");
    // At the same speed nothing closes: 5.5 m at 10 m/s.
    let found = pair([[0.0, 0.0, 0.0, 10.0], [10.0, 0.0, 0.0, 10.0]]);
    assert_eq!((found.min_ttc_s, found.max_drac_mps2), (None, 0.0));
    assert!(near(found.min_headway_s, Some(0.55)));
}

#[test]
fn crossing_at_right_angles() {
    // The conflict area is a square of 1.8 m. The first leaves it with its center at x = 3.15, after 2.315 s; the
    // second enters it with its center at y = -3.15, after 2.985 s.
    let found = pair([[-20.0, 0.0, 0.0, 10.0], [0.0, -33.0, 90.0, 10.0]]);
    assert!(found.pet_s.is_some_and(|pet_s| (pet_s - 0.67).abs() < 1e-3), "{found:?}");
    assert_eq!((found.min_ttc_s, found.min_headway_s), (None, None));
    // Both are in it from 1.785 to 2.315 s.
    let found = pair([[-20.0, 0.0, 0.0, 10.0], [0.0, -21.0, 90.0, 10.0]]);
    assert_eq!((found.pet_s, found.min_ttc_s, found.min_distance_m), (None, Some(0.0), 0.0));
    assert_eq!(found.max_drac_mps2, MAX_DRAC_MPS2);
    // Before both have passed, they are on the course: at 1.0 s the first has 6.85 m to its entry, the second 7.85 m.
    // They touch when the second enters, 0.785 s later.
    let moving = MovingAgent::of(&scene(&[[-20.0, 0.0, 0.0, 10.0], [0.0, -21.0, 90.0, 10.0]]), 0).expect("tracked");
    let other = MovingAgent::of(&scene(&[[0.0, -21.0, 90.0, 10.0]]), 0).expect("tracked");
    assert!(near(Closing::over(&moving, &other, 10..11, 0.1).min_ttc_s, Some(0.785)));
}

#[test]
fn parallel_lanes_never_conflict() {
    let found = pair([[0.0, 0.0, 0.0, 15.0], [10.0, 3.5, 0.0, 10.0]]);
    let expected = PairCriticality { min_distance_m: found.min_distance_m, ..PairCriticality::default() };
    assert_eq!(found, expected);
    assert!((found.min_distance_m - 1.7).abs() < 1e-6);
}

#[test]
fn standing_vehicles_threaten_nobody() {
    let found = pair([[0.0, 0.0, 0.0, 0.0], [10.0, 0.0, 0.0, 0.0]]);
    assert_eq!(found, PairCriticality { min_distance_m: found.min_distance_m, ..PairCriticality::default() });
    assert!((found.min_distance_m - 5.5).abs() < 1e-9);
    assert_eq!(SceneCriticality::of(&scene(&[[0.0, 0.0, 0.0, 0.0], [10.0, 0.0, 0.0, 0.0]])), None);
}

#[test]
fn overlapping_at_the_start_is_the_worst_for_a_pair_and_no_pair_of_a_scene() {
    let cars = [[0.0, 0.0, 0.0, 10.0], [2.0, 0.0, 0.0, 10.0]];
    let found = pair(cars);
    assert_eq!((found.min_ttc_s, found.max_drac_mps2, found.min_distance_m), (Some(0.0), MAX_DRAC_MPS2, 0.0));
    assert!((found.tet_s - 3.0).abs() < 1e-9 && (found.tit_s2 - 4.5).abs() < 1e-9);
    assert_eq!(SceneCriticality::of(&scene(&cars)), None);
}

#[test]
fn the_quick_search_finds_what_all_pairs_have() {
    let (mut n_collisions, mut n_courses, mut n_calm) = (0, 0, 0);
    for seed in 0..40 {
        let scene = random_scene(seed, 2 + seed as usize % 8, 60.0);
        let present = scene.current_timestep();
        let counts = |i: usize, j: usize| {
            let boxes = scene.tracks[i].footprint_at(present).zip(scene.tracks[j].footprint_at(present));
            let moves = |i: usize| super::super::collision_rate::is_moving(&scene, i);
            boxes.is_some_and(|(a, b)| !a.overlaps(&b)) && (moves(i) || moves(j))
        };
        let n = scene.tracks.len();
        let pairs: Vec<PairCriticality> = (0..n)
            .flat_map(|i| (i + 1..n).map(move |j| (i, j)))
            .filter(|(i, j)| counts(*i, *j))
            .filter_map(|(i, j)| PairCriticality::of(&scene, [i, j]))
            .collect();
        let Some(worst) = SceneCriticality::of(&scene) else {
            assert!(pairs.is_empty());
            continue;
        };
        let min_ttc_s = pairs.iter().filter_map(|pair| pair.min_ttc_s).reduce(f64::min);
        assert_eq!(worst.min_ttc_s, min_ttc_s, "seed {seed}");
        assert_eq!(worst.max_drac_mps2, pairs.iter().map(|pair| pair.max_drac_mps2).fold(0.0, f64::max));
        assert_eq!(Some(worst.min_distance_m), pairs.iter().map(|pair| pair.min_distance_m).reduce(f64::min));
        match min_ttc_s {
            Some(0.0) => n_collisions += 1,
            Some(_) => n_courses += 1,
            None => n_calm += 1,
        }
    }
    // The scenes are of no use to this test unless all outcomes occur.
    assert!(n_collisions > 3 && n_courses > 3 && n_calm > 0, "{n_collisions} {n_courses} {n_calm}");
}

#[test]
fn metrics_are_of_the_agents_that_were_asked() {
    let samples = [30.2, 40.2].map(|x| scene(&[[0.0, 0.0, 0.0, 15.0], [200.0, 9.0, 0.0, 10.0], [x, 0.0, 0.0, 10.0]]));
    let asked = Roles::from([("ego", "0"), ("other", "2")]);
    let group = SampleGroup { asked: &asked, ..SampleGroup::equally_likely(&samples[0], &samples) };
    assert!(near(PairMetric::MinTtc.evaluate(&group), Some(f64::midpoint(1.24, 3.24))));
    assert!(near(SceneMetric::MinTtc.evaluate(&group), Some(f64::midpoint(1.24, 3.24))));
    let group = SampleGroup { asked: Roles::none(), ..group };
    assert_eq!(PairMetric::MinTtc.evaluate(&group), None);
}
