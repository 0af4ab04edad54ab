//! All of the development data: archives and samples that a machine may lack.

use super::*;
use crate::ingest::UnitSplit;
use crate::ingest::test_data::test_data;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Number of scenes by split and place; panics on a reject.
fn count_scenes(inputs: Vec<PathBuf>) -> BTreeMap<String, usize> {
    let config = IngestConfig { inputs, ..config(Path::new("")) };
    let mut counts = BTreeMap::new();
    for scene in read_scenes(&config) {
        let scene = scene.unwrap();
        assert!(scene.tracks.iter().all(|track| track.trajectory.n_timesteps() == scene.n_timesteps));
        assert!(scene.heading_gaps.is_empty());
        *counts.entry(format!("{}/{}", scene.source.split.name(), scene.source.place)).or_default() += 1;
    }
    counts
}

#[test]
fn all_of_the_simulated_archive_is_read() {
    let Some(archive) = test_data("archives/INTERACTION-sim-multi-v1_2.zip") else { return };
    let counts = count_scenes(vec![archive]);
    let total = |split: &str| counts.iter().filter(|(key, _)| key.starts_with(split)).map(|(_, n)| n).sum::<usize>();
    assert_eq!((total("train/"), total("val/"), total("test/")), (5000, 700, 300), "{counts:?}");
    assert_eq!((counts["train/SIM_Merging"], counts.len()), (3000, 9));
}

#[test]
fn samples_of_both_versions_are_read() {
    let Some(samples) = test_data("samples/interaction") else { return };
    let counts = count_scenes(vec![samples.join("val")]);
    assert_eq!(counts.values().sum::<usize>(), 90, "{counts:?}");

    let config = IngestConfig { holdout_share: 0.0, ..config(&samples.join("recorded_trackfiles")) };
    let units = read_units(&config).unwrap();
    let pairs: Vec<(String, bool)> = units
        .iter()
        .map(|unit| unit.as_ref().unwrap())
        .map(|unit| {
            assert_eq!((unit.version, unit.split), ("v1.1", UnitSplit::Divided));
            (format!("{}/{}", unit.place, unit.case_id), unit.companion.is_some())
        })
        .collect();
    let n_with_pedestrians = pairs.iter().filter(|(_, has_pedestrians)| *has_pedestrians).count();
    assert_eq!((pairs.len(), n_with_pedestrians), (7, 4), "{pairs:?}");
    let scenes = read_scenes(&config);
    assert!(scenes.len() > 7 * 50 && scenes.iter().all(Result::is_ok));
    let n_pedestrians = scenes
        .iter()
        .flat_map(|scene| &scene.as_ref().unwrap().tracks)
        .filter(|track| track.class == AgentClass::PedestrianOrCyclist)
        .count();
    assert!(n_pedestrians > 100, "{n_pedestrians}");
}

#[test]
fn the_toy_recording_of_the_interaction_authors_is_read() {
    let Some(samples) = test_data("samples/interaction_official") else { return };
    let config = IngestConfig { holdout_share: 0.0, n_future: Some(5), ..config(&samples) };
    let scenes = read_scenes(&config);
    // The second car comes at frame 31 and drives the other way.
    assert_eq!(outcomes(&scenes).len(), 3);
    let scene = scenes[1].as_ref().unwrap();
    let [first, second] = scene.tracks.as_slice() else { panic!("two cars") };
    let state = first.trajectory.get(0).unwrap();
    assert_eq!((state.position.x, state.position.y, state.heading_rad), (41.0, 2.5, 0.0));
    let state = second.trajectory.get(0).unwrap();
    assert_eq!((state.position.x, state.position.y, state.velocity.x), (90.0, 5.5, 10.0));
    assert!((state.heading_rad - std::f64::consts::PI).abs() < 1e-4);
}
