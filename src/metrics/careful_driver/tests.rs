//! The careful driver against encounters that another program worked out.

use super::braking::Braking;
use super::*;
use crate::geometry::Vec2;
use crate::metrics::{Metric, SampleGroup};
use crate::scene::testing::{Drive, scene};
use crate::scene::{AgentClass, Extent, Roles, Scene, State, Track, Trajectory};
use serde::Deserialize;

fn near(found: f64, expected: f64) -> bool {
    (found - expected).abs() < 1e-9
}

#[test]
fn braking_grows_stays_and_ends() {
    let at = |speed_mps, from_s| Braking { speed_mps, from_s, ramp_s: 0.5, max_deceleration_mps2: 8.0 };
    // From 10 m/s at 1 s: the ramp takes 2 m/s and ends at 15 - 8 · 0.5² / 6 m; 8 m/s at 8 m/s² are 1 s and 4 m.
    let braking = at(10.0, Some(1.0));
    assert!(near(braking.driven_m(1.0), 10.0) && near(braking.speed_mps(1.5), 8.0));
    assert!(near(braking.driven_m(1.5), 15.0 - 1.0 / 3.0) && near(braking.speed_mps(2.0), 4.0));
    assert!(near(braking.stands_from_s().expect("stands"), 2.5) && near(braking.driven_m(9.0), 19.0 - 1.0 / 3.0));
    assert_eq!(braking.speed_mps(2.5), 0.0);
    // From 1 m/s it stands while the deceleration grows: 8 t² = 1 m/s.
    let braking = at(1.0, Some(1.0));
    let t = 0.125_f64.sqrt();
    assert!(near(braking.stands_from_s().expect("stands"), 1.0 + t));
    assert!(near(braking.driven_m(5.0), 1.0 + t - 8.0 * t.powi(3) / 3.0));
    let steady = at(10.0, None);
    assert!(near(steady.driven_m(3.0), 30.0) && steady.stands_from_s().is_none());
}

#[derive(Deserialize)]
struct Other {
    class: String,
    states: Vec<[f64; 4]>,
}

/// `scripts/golden_careful_driver.py` writes them.
#[derive(Deserialize)]
struct Encounter {
    name: String,
    speed_mps: f64,
    others: Vec<Other>,
    braking_from_s: Option<f64>,
    preventable: bool,
    margin_s: f64,
}

fn encounters() -> Vec<Encounter> {
    serde_json::from_str(include_str!("../../../tests/golden/careful_driver.json")).unwrap()
}

/// The ego at constant speed along x, and the others.
fn played(encounter: &Encounter) -> Scene {
    let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, encounter.speed_mps)]);
    let (n, n_history) = (encounter.others[0].states.len(), 10);
    let ego = (0..n).map(|t| {
        let x = encounter.speed_mps * (t as f64 - 9.0) * 0.1;
        [x, 0.0, encounter.speed_mps, 0.0]
    });
    let track = |id: &str, class: AgentClass, states: Vec<[f64; 4]>| {
        let state = |[x, y, vx, vy]: [f64; 4]| State {
            position: Vec2::new(x, y),
            heading_rad: 0.0,
            velocity: Vec2::new(vx, vy),
        };
        let [length_m, width_m] = if class == AgentClass::Pedestrian { [0.5, 0.5] } else { [4.5, 1.9] };
        Track {
            id: id.into(),
            class,
            extent: Some(Extent { length_m, width_m }),
            trajectory: Trajectory::new(states.into_iter().map(|at| Some(state(at))).collect()),
            ..scene.tracks[0].clone()
        }
    };
    let others = encounter.others.iter().enumerate().map(|(i, other)| {
        let class = AgentClass::ALL.into_iter().find(|class| class.name() == other.class).unwrap();
        track(&format!("other_{i}"), class, other.states.clone())
    });
    let tracks = [track("ego", AgentClass::Vehicle, ego.collect())].into_iter().chain(others).collect();
    (scene.tracks, scene.n_history, scene.n_timesteps, scene.dt_s) = (tracks, n_history, n, 0.1);
    scene
}

#[test]
fn encounters_end_as_another_program_found() {
    let encounters = encounters();
    for (case, n_least) in [("cut-in", 10), ("cut-out", 4), ("deceleration", 6), ("pedestrian", 6)] {
        let of_case = encounters.iter().filter(|encounter| encounter.name.starts_with(case));
        assert!(of_case.count() >= n_least, "{case}");
    }
    for encounter in &encounters {
        let scene = played(encounter);
        let found = CarefulReplay::of(&scene, 0).unwrap().judgment_with_margin(Some(1));
        let (name, margin_s) = (&encounter.name, found.margin_s.unwrap());
        let is_same = match found.braking_from_s.zip(encounter.braking_from_s) {
            Some((found, expected)) => (found - expected).abs() < 0.11,
            None => found.braking_from_s == encounter.braking_from_s,
        };
        assert!(is_same && (margin_s - encounter.margin_s).abs() < 0.12, "{name}: {found:?} {}", encounter.margin_s);
        assert!(found.preventable == encounter.preventable || margin_s.abs() < 0.1, "{name}: {found:?}");
        assert!(found.preventable == (margin_s >= 0.0), "{name}: {found:?}");
        // Paragraph 5.2.5.2 demands nothing that the careful driver does not do.
        assert!(found.avoidance_required != Some(true) || found.preventable, "{name}: {found:?}");
    }
}

#[test]
fn the_driver_knows_what_it_has_seen_and_nothing_else() {
    let encounters = encounters();
    let encounter = encounters.iter().find(|encounter| encounter.name == "cut-in 22.0 8.0 1.0").unwrap();
    let (whole, way) = (played(encounter), |scene: &Scene| Way::of(scene, 0).unwrap());
    let demands = |n_looks: usize| {
        let mut driver = CarefulDriver::new(1, 1.9, 0.0);
        (0..n_looks).for_each(|t| {
            let (ego, other) = (whole.state(0, t).unwrap(), whole.state(1, t).unwrap());
            let way = way(&whole);
            let place = way.place(&whole.tracks[1], other).unwrap();
            let driven_m = way.route.driven_m(ego.position).unwrap();
            driver.look(
                [t as f64 * 0.1, 0.1],
                ego.speed_mps(),
                [Some(place.seen_from(driven_m, 20.0, 4.5))].into_iter(),
            );
        });
        driver.acceleration_mps2([20.0, 0.0], 20.0, 0.1)
    };
    // Perceived 0.4 s after 0.375 m at 1 m/s, it first eases off, by as much as in a timestep, and then brakes.
    assert!([10, 13, 16].map(demands).iter().all(|mps2| near(*mps2, 0.0)));
    assert!((-2.0..-1.0).contains(&demands(18)) && demands(31) < -7.0, "{} {}", demands(18), demands(31));
}

#[test]
fn who_drives_into_its_rear_and_who_overlaps_it_at_present_do_not_count() {
    let encounters = encounters();
    let mut scene = played(&encounters[0]);
    let states = |gap_m: f64, more_mps: f64| {
        let state = |t: usize| {
            let (velocity, since_s) = (Vec2::new(20.0 + more_mps, 0.0), (t as f64 - 9.0) * 0.1);
            Some(State { position: Vec2::new(gap_m, 0.0) + velocity * since_s, heading_rad: 0.0, velocity })
        };
        Trajectory::new((0..scene.n_timesteps).map(state).collect())
    };
    for (gap_m, more_mps, is_preventable) in [(-15.0, 5.0, true), (2.0, 0.0, true), (8.0, -10.0, false)] {
        scene.tracks[1].trajectory = states(gap_m, more_mps);
        let replay = CarefulReplay::of(&scene, 0).unwrap();
        assert_eq!(replay.contact().is_none(), is_preventable, "{gap_m} m");
    }
    scene.tracks[0].trajectory = Trajectory::new(vec![None; scene.n_timesteps]);
    assert!(CarefulReplay::of(&scene, 0).is_none());
}

#[test]
fn the_rate_is_over_samples_that_come_into_the_lane() {
    let encounters = encounters();
    let named = |name: &str| encounters.iter().find(|encounter| encounter.name == name).map(played).unwrap();
    let mut samples = vec![named("cut-in 30.0 4.0 1.8"), named("cut-in 8.0 8.0 1.0"), named("cut-in 30.0 4.0 1.8")];
    let aside = samples[2].tracks[1]
        .trajectory
        .entries()
        .iter()
        .map(|state| state.map(|state| State { position: Vec2::new(state.position.x, 3.5), ..state }));
    samples[2].tracks[1].trajectory = Trajectory::new(aside.collect());
    let asked = Roles::from([("ego", "ego"), ("other", "other_0")]);
    let group = SampleGroup { asked: &asked, ..SampleGroup::equally_likely(&samples[0], &samples) };
    assert_eq!(PreventableRate.evaluate(&group), Some(0.5));
    assert_eq!(PreventableRate.evaluate(&SampleGroup { samples: &samples[2..], ..group }), None);
    assert_eq!(PreventableRate.evaluate(&SampleGroup { asked: Roles::none(), ..group }), None);
    let cut_off = Scene { n_timesteps: samples[0].n_history, ..samples[0].clone() };
    assert_eq!(PreventableRate.evaluate(&SampleGroup { recorded: &cut_off, ..group }), None, "a test split");
}
