//! Is a store whole or resumable whatever interrupts its writer, and what does it reject?

use super::*;
use crate::files::{keep_list, remove_leftovers};
use crate::store::testing::{folder_bytes, map, scene};
use serde_json::json;

/// The batches of a job: (scenes, maps first needed, units done).
type Batch = (Vec<Scene>, Vec<(MapId, LaneGraph)>, u64);

fn batches() -> Vec<Batch> {
    let maps: Vec<(MapId, LaneGraph)> = (0..3).map(|i| (MapId(format!("map {i}")), map(i, 8))).collect();
    let scenes = |range: std::ops::Range<u64>, map_idx: usize| -> Vec<Scene> {
        let (id, graph) = &maps[map_idx];
        range.map(|seed| scene(seed, Some((id, graph)))).collect()
    };
    vec![
        (scenes(0..3, 0), vec![maps[0].clone()], 4),
        (Vec::new(), Vec::new(), 6),
        (scenes(3..6, 0), Vec::new(), 9),
        (scenes(6..9, 1), vec![maps[1].clone()], 12),
        (scenes(9..10, 0), Vec::new(), 13),
        (scenes(10..12, 2), vec![maps[2].clone()], 15),
        (Vec::new(), Vec::new(), 16),
    ]
}

/// The writer of the store, and where it continues.
fn writer_in(dir: &Path) -> (SceneWriter, Option<ShardSidecar>) {
    let (writer, last) = SceneWriter::resume(dir).unwrap();
    (writer.in_shards_of(4), last)
}

/// Writes the batches that are not done yet. As in an ingest after an interruption, all maps that they need are given
/// again when they first occur.
fn write_rest(writer: &mut SceneWriter, done: u64, n_batches: usize) {
    let all = batches();
    let mut given = BTreeSet::new();
    for (scenes, _, units_done) in all.iter().take(n_batches).filter(|(.., units_done)| *units_done > done) {
        let needed: BTreeSet<&MapId> = scenes.iter().filter_map(|scene| scene.map_id.as_ref()).collect();
        let maps = all.iter().flat_map(|(_, maps, _)| maps).filter(|(id, _)| needed.contains(id));
        let maps: Vec<_> = maps.filter(|(id, _)| given.insert(id.clone())).cloned().collect();
        writer.write_batch(scenes, &maps, Some(*units_done), &json!({ "units": units_done })).unwrap();
    }
}

fn uninterrupted(dir: &Path) -> SceneManifest {
    let (mut writer, _) = writer_in(dir);
    write_rest(&mut writer, 0, usize::MAX);
    writer.finish(&json!({ "units": 16 })).unwrap()
}

#[test]
fn shards_end_with_the_batch_that_fills_them() {
    let dir = tempfile::tempdir().unwrap();
    let manifest = uninterrupted(dir.path());
    let n_scenes: Vec<u64> = manifest.shards.iter().map(|shard| shard.n_scenes).collect();
    assert_eq!(n_scenes, [6, 4, 2]);
    let n_maps: Vec<u64> = manifest.shards.iter().filter_map(|shard| shard.maps.as_ref()).map(|m| m.n_maps).collect();
    assert_eq!(n_maps, [1, 1, 1]);
    assert_eq!((manifest.n_scenes, manifest.n_maps), (12, 3));
    assert_eq!(SceneManifest::read(dir.path()).unwrap(), manifest);
}

#[test]
fn a_shard_never_ends_within_a_unit() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) = writer_in(dir.path());
    let all: Vec<Scene> = (0..9).map(|seed| scene(seed, None)).collect();
    for (scenes, units_done) in [(0..5, None), (5..6, Some(1)), (6..9, Some(2))] {
        writer.write_batch(&all[scenes], &[], units_done, &json!({ "units": units_done })).unwrap();
    }
    std::mem::forget(writer);
    let (_, last) = writer_in(dir.path());
    let last = last.expect("a whole shard");
    assert_eq!((last.shard.n_scenes, last.units_done, last.report), (6, 1, json!({ "units": 1 })));
}

#[test]
fn a_resumed_store_has_the_bytes_of_an_uninterrupted_one() {
    let whole = tempfile::tempdir().unwrap();
    uninterrupted(whole.path());
    let expected = folder_bytes(whole.path());
    for n_batches in 0..=batches().len() {
        let dir = tempfile::tempdir().unwrap();
        let store = dir.path().join("scenes");
        keep_list(dir.path()).unwrap();
        let (mut writer, _) = writer_in(&store);
        write_rest(&mut writer, 0, n_batches);
        // A killed process does not clean up; the owner of the list does.
        std::mem::forget(writer);
        remove_leftovers(dir.path()).unwrap();
        let (mut writer, last) = writer_in(&store);
        write_rest(&mut writer, last.as_ref().map_or(0, |sidecar| sidecar.units_done), usize::MAX);
        writer.finish(&json!({ "units": 16 })).unwrap();
        assert!(folder_bytes(&store) == expected, "interrupted after {n_batches} batches");
    }
}

#[test]
fn a_kill_between_any_two_renames_is_survived() {
    let whole = tempfile::tempdir().unwrap();
    uninterrupted(whole.path());
    let expected = folder_bytes(whole.path());
    // Files get their names in this order; a kill leaves a prefix of it. (Half-written files have other names; the
    // owner of the folder's list removes them.)
    let mut order: Vec<String> = Vec::new();
    for shard_idx in 0..3 {
        order.push(shard_name("maps", shard_idx, "arrow"));
        order.push(shard_name("scenes", shard_idx, "arrow"));
        order.push(sidecar_name(shard_idx));
    }
    order.push(MANIFEST_FILE.to_owned());
    assert_eq!(order.len(), expected.len());
    for n_named in 0..=order.len() {
        let dir = tempfile::tempdir().unwrap();
        for name in &order[..n_named] {
            fs::write(dir.path().join(name), &expected[name]).unwrap();
        }
        let (mut writer, last) = writer_in(dir.path());
        assert_eq!(last.is_some(), n_named >= 3);
        write_rest(&mut writer, last.map_or(0, |sidecar| sidecar.units_done), usize::MAX);
        writer.finish(&json!({ "units": 16 })).unwrap();
        assert!(folder_bytes(dir.path()) == expected, "killed after {n_named} renames");
    }
}

#[test]
fn shards_after_one_that_is_not_finished_are_removed_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    uninterrupted(dir.path());
    fs::write(dir.path().join("scenes-of-mine.txt"), "keep").unwrap();
    fs::remove_file(dir.path().join(sidecar_name(0))).unwrap();
    assert!(writer_in(dir.path()).1.is_none());
    assert_eq!(folder_bytes(dir.path()).into_keys().collect::<Vec<_>>(), ["scenes-of-mine.txt"]);
}

#[test]
fn a_scene_that_comes_twice_is_refused_even_after_an_interruption() {
    let dir = tempfile::tempdir().unwrap();
    let batches = batches();
    let mut writer = SceneWriter::resume(dir.path()).unwrap().0.in_shards_of(3);
    let (scenes, maps, units) = &batches[0];
    writer.write_batch(scenes, maps, Some(*units), &json!({})).unwrap();
    for mut writer in [writer, SceneWriter::resume(dir.path()).unwrap().0] {
        let mut again = scenes[1].clone();
        again.source.file = "day2/again.csv".into();
        let error = writer.write_batch(&[again], &[], Some(units + 1), &json!({})).unwrap_err();
        let expected = [scenes[1].source.file.clone(), "day2/again.csv".to_owned()];
        let is_said =
            matches!(&error, Error::DuplicateScene { id, files } if *id == scenes[1].id.0 && *files == expected);
        assert!(is_said, "{error}");
        assert!(error.to_string().contains("from train/data/1.csv and from day2/again.csv"), "{error}");
    }
    let (writer, _) = SceneWriter::resume(dir.path()).unwrap();
    assert_eq!(writer.identities().unwrap(), scenes.iter().map(Scene::identity).collect());
    let mut moved = scenes[1].clone();
    moved.world_from_scene.translation.x += 1.0;
    assert_ne!(moved.identity(), scenes[1].identity());
}

#[test]
fn a_scene_whose_map_was_never_given_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) = writer_in(dir.path());
    let scenes = [scene(1, Some((&MapId::from("PIT"), &map(1, 8))))];
    let error = writer.write_batch(&scenes, &[], Some(1), &Value::Null).unwrap_err();
    assert_eq!(error.to_string(), "cannot store argoverse1/train/PIT/1: its map was not added before it");
}

#[test]
fn states_that_are_not_finite_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) = writer_in(dir.path());
    let mut scene = scene(1, None);
    let mut states = scene.tracks[0].trajectory.entries().to_vec();
    states[5].as_mut().unwrap().velocity.x = 1e300;
    scene.tracks[0].trajectory = crate::scene::Trajectory::new(states);
    let error = writer.write_batch(&[scene], &[], Some(1), &Value::Null).unwrap_err();
    assert!(error.to_string().contains("track track-0 is not finite at timestep 5"), "{error}");
}
