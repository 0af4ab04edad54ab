//! Properties of cut-ins in any traffic; the example scenes specify the definition itself.

use super::*;
use crate::behavior::testing::{SceneSpec, random_scene, transformed};
use crate::geometry::{Transform2, Vec2};

/// Random traffic on lanes of 4 m along x.
fn random_traffic(seed: u64, size_m: f64) -> Scene {
    let lane = |i: i32| format!("{{ id = {i}, centerline = [[-90, {y}], [90, {y}]], width_m = 4.0 }}", y = 4 * i - 32);
    let lanes: Vec<String> = (1..16).map(lane).collect();
    let spec: Result<SceneSpec, _> = toml::from_str(&format!("agents = []\nlanes = [{}]", lanes.join(", ")));
    Scene { lanes: spec.expect("valid").build("lanes").lanes, ..random_scene(seed, 9, size_m) }
}

/// Random traffic does not test lanes, but which pairs are examined: each pair has at most one event, and pairs that
/// are near have one.
#[test]
fn every_near_pair_has_one_event() {
    let (mut n_positive, mut n_negative) = (0, 0);
    for seed in 0..60 {
        let scene = random_traffic(seed, 28.0);
        let events = CutIn::default().detect(&scene);
        let mut pairs: Vec<_> = events.iter().map(|event| event.roles.clone()).collect();
        pairs.sort();
        pairs.dedup();
        assert_eq!(pairs.len(), events.len(), "seed {seed}");
        for event in &events {
            let turned: Vec<_> = event.roles.iter().rev().map(|(_, track)| track).collect();
            let reverse = |other: &&BehaviorEvent| other.roles.tracks().eq(turned.iter().copied());
            let both = [event.label, events.iter().find(reverse).expect("the pair the other way round").label];
            assert_ne!(both, [EventLabel::Positive; 2], "seed {seed}: each cuts in before the other");
        }
        let count = |label: EventLabel| events.iter().filter(|event| event.label == label).count();
        (n_positive, n_negative) = (n_positive + count(EventLabel::Positive), n_negative + count(EventLabel::Negative));
    }
    assert!(n_positive > 0 && n_negative > 500, "{n_positive} {n_negative}");
}

#[test]
fn neither_place_nor_direction_of_the_frame_counts() {
    let moved = Transform2::from_pose(Vec2::new(812.0, -77.0), -1.3);
    for seed in 0..20 {
        let scene = random_traffic(seed, 28.0);
        let outline = |scene: &Scene| -> Vec<_> {
            let events = CutIn::default().detect(scene);
            events
                .into_iter()
                .map(|event| (event.label, event.roles, event.start_timestep, event.end_timestep))
                .collect()
        };
        assert_eq!(outline(&scene), outline(&transformed(&scene, &moved)), "seed {seed}");
    }
}

#[test]
fn scenes_without_a_future_have_no_events() {
    let scene = random_traffic(1, 20.0);
    assert!(!CutIn::default().detect(&scene).is_empty());
    assert!(CutIn::default().detect(&Scene { n_timesteps: scene.n_history, ..scene }).is_empty());
}
