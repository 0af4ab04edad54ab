//! Is a corpus read back as it was written, and is damage found?

use super::*;
use crate::files::keep_list;
use crate::metrics::Group;
use crate::scene::{LaneGraph, Scene};
use crate::store::testing::{assessment, event, folder_bytes, map, record, scene};
use crate::store::{Columns, CorpusReader, CorpusScan, SceneStore, SceneWriter};
use serde_json::Value;

/// A scene at one of two places.
fn scene_at(seed: u64, map: Option<(&MapId, &LaneGraph)>) -> Scene {
    let mut scene = scene(seed, map);
    scene.source.place = if seed % 4 == 1 { "São Paulo" } else { "PIT" }.to_owned();
    scene
}

/// The records in the order in which a corpus keeps them: by behavior and place, and within each in the given order.
fn in_order(records: &[ScenarioRecord]) -> Vec<&ScenarioRecord> {
    let mut sorted: Vec<&ScenarioRecord> = records.iter().collect();
    sorted.sort_by_key(|r| (r.requested_behavior.clone().unwrap_or("none".to_owned()), &r.scenario.scene.source.place));
    sorted
}

/// A store of some scenes on two maps, and scenarios from them.
fn store_and_records(dir: &Path) -> (SceneStore, Vec<ScenarioRecord>) {
    let maps: Vec<(MapId, LaneGraph)> = vec![("PIT".into(), map(1, 9)), ("MIA".into(), map(2, 7))];
    let scenes: Vec<Scene> =
        (0..70).map(|i| scene_at(i, maps.get(i as usize % 3).map(|(id, graph)| (id, graph)))).collect();
    let (mut writer, _) = SceneWriter::resume(dir).unwrap();
    writer.write_batch(&scenes, &maps, Some(1), &Value::Null).unwrap();
    writer.finish(&Value::Null).unwrap();
    let mut records: Vec<ScenarioRecord> = scenes.iter().flat_map(|scene| (0..2).map(|i| record(scene, i))).collect();
    for record in records.iter_mut().step_by(7) {
        record.requested_behavior = None;
    }
    for (i, record) in records.iter_mut().enumerate().filter(|(i, _)| i % 3 > 0) {
        record.assessment = Some(assessment(&record.scenario.scene, i % 3 == 1));
    }
    // A parameter that occurs late, in a batch of its own.
    let last = records.last_mut().unwrap();
    last.events = vec![event(&last.scenario.scene.id, "cut_in", &[("ttc_s", 2.5)])];
    (SceneStore::open(dir).unwrap(), records)
}

fn recorded(store: &SceneStore, record: &ScenarioRecord) -> Scene {
    store.scene(store.position(&record.scenario.scene.id).unwrap()).unwrap()
}

fn metric_row() -> MetricRow {
    MetricRow {
        group: Group::Recorded,
        sweep: String::new(),
        place: "PIT".to_owned(),
        n: 4,
        ..MetricRow::example("collision_rate", 0.25)
    }
}

fn write(dir: &Path, store: &SceneStore, records: &[ScenarioRecord], batch_len: usize) -> CorpusManifest {
    let mut writer = CorpusWriter::create(dir, store).unwrap();
    for batch in records.chunks(batch_len) {
        writer.write_scenarios(batch).unwrap();
        for record in batch {
            writer.write_recording(&recorded(store, record)).unwrap();
        }
    }
    writer.write_metrics([Ok(metric_row())]).unwrap();
    let left_out = [("guided".to_owned(), [("not_verified".to_owned(), 7)].into())].into();
    // Terms of recordings that the corpus lacks have no place in it.
    let sources = [("argoverse2".to_owned(), "MIT".to_owned())].into();
    writer.finish(&CorpusNotes { left_out, sources, ..CorpusNotes::default() }).unwrap()
}

#[test]
fn scenarios_come_back_as_they_were() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    let manifest = write(dir.path(), &store, &records, 33);
    assert_eq!((manifest.n_scenarios, manifest.n_verified, manifest.n_maps), (140, 70, 2));
    assert_eq!(manifest.scenarios_by_sweep["guided"], 140);
    assert_eq!(manifest.left_out["guided"]["not_verified"], 7);
    assert!(manifest.sources["argoverse1"].contains("CC BY-NC-SA 4.0") && manifest.sources.len() == 1);

    let reader = CorpusReader::open(dir.path()).unwrap();
    assert_eq!(*reader.manifest(), manifest);
    assert_eq!(reader.metrics().unwrap(), [metric_row()]);
    let ordered = in_order(&records);
    assert!(reader.scenario_ids().unwrap().eq(ordered.iter().map(|record| record.scenario.id.as_str())));
    for (i, record) in ordered.iter().enumerate().rev() {
        assert_eq!(reader.scenario(i).unwrap(), **record, "scenario {i}");
        let recording = recorded(&store, record);
        let n_timesteps = recording.n_timesteps;
        let tracks = reader.recorded_tracks(&recording.id, n_timesteps).unwrap().unwrap();
        assert_eq!(tracks, recording.tracks);
    }
    assert_eq!(reader.recorded_tracks(&"nowhere".into(), 5).unwrap(), None);
    assert_eq!(reader.position(&ordered[7].scenario.id).unwrap(), 7);
    assert!(reader.scenario(140).unwrap_err().to_string().ends_with("holds no scenario number 140 of 140"));
}

#[test]
fn the_same_scenarios_give_the_same_bytes_however_they_come() {
    let (store_dir, one, two) =
        (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    write(one.path(), &store, &records, 5);
    write(two.path(), &store, &records, 140);
    assert!(folder_bytes(one.path()) == folder_bytes(two.path()));
}

#[test]
fn an_abandoned_corpus_is_no_corpus() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    let corpus = dir.path().join("corpus");
    keep_list(dir.path()).unwrap();
    write(&corpus, &store, &records, 33);
    let mut writer = CorpusWriter::create(&corpus, &store).unwrap();
    writer.write_scenarios(&records[..3]).unwrap();
    drop(writer);
    assert_eq!(folder_bytes(&corpus).len(), 0);
    assert!(matches!(CorpusReader::open(&corpus).err(), Some(Error::Unfinished { .. })));
}

#[test]
fn an_id_cannot_occur_twice() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    let mut writer = CorpusWriter::create(dir.path(), &store).unwrap();
    let error = writer.write_scenarios(&[records[0].clone(), records[0].clone()]).unwrap_err();
    assert!(error.to_string().ends_with("another scenario has this id"), "{error}");
    let mut twins = records[1].clone();
    twins.scenario.scene.tracks[1].id = twins.scenario.scene.tracks[0].id.clone();
    let error = writer.write_scenarios(&[twins]).unwrap_err();
    assert!(error.to_string().ends_with("two of its tracks have the same id"), "{error}");
}

#[test]
fn partitions_are_folders_and_counted() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    let manifest = write(dir.path(), &store, &records, 33);
    let files: Vec<String> = folder_bytes(dir.path()).into_keys().collect();
    let parts = |table: &str| {
        [
            "behavior=cut_in/place=PIT",
            "behavior=cut_in/place=S%C3%A3o%20Paulo",
            "behavior=none/place=PIT",
            "behavior=none/place=S%C3%A3o%20Paulo",
        ]
        .map(|folder| format!("{table}/{folder}/part-00000.parquet"))
    };
    let mut expected = vec!["README.md".to_owned(), "lanes.parquet".to_owned(), "manifest.json".to_owned()];
    expected.extend(["metrics.parquet".to_owned()]);
    expected.extend(["PIT", "S%C3%A3o%20Paulo"].map(|place| format!("recordings/place={place}/part-00000.parquet")));
    expected.extend(parts("scenarios"));
    expected.extend(parts("tracks"));
    assert_eq!(files, expected);
    // Every seventh record has no requested behavior: 20 of 140. Scenes 1, 5, … 69 are at the second place: 18 with two
    // records each.
    let counts: Vec<u64> = manifest.scenarios_by_partition.iter().map(|count| count.n_scenarios).collect();
    let elsewhere = |records: &[ScenarioRecord], behavior: bool| {
        let is_counted =
            |r: &&ScenarioRecord| r.scenario.scene.source.place != "PIT" && r.requested_behavior.is_some() == behavior;
        records.iter().filter(is_counted).count() as u64
    };
    let (cut_in, none) = (elsewhere(&records, true), elsewhere(&records, false));
    assert_eq!(cut_in + none, 36);
    assert_eq!(counts, [120 - cut_in, cut_in, 20 - none, none]);
    assert_eq!(manifest.n_recordings, 70);
    let n_states: usize =
        records.iter().flat_map(|r| &r.scenario.scene.tracks).map(|track| track.trajectory.n_valid()).sum();
    assert_eq!(manifest.tables["tracks"].n_rows, n_states as u64);
    assert_eq!(manifest.tables["tracks"].files[1].partition.place.as_deref(), Some("São Paulo"));
}

#[test]
fn what_folders_are_named_for_is_no_column_of_their_files() {
    let dir = tempfile::tempdir().unwrap();
    let (store, records) = store_and_records(dir.path());
    let path = dir.path().join("corpus");
    let manifest = write(&path, &store, &records, 7);
    for table in CorpusTable::ALL {
        for file in manifest.files(table) {
            let (content, _) = fs_err::File::open(path.join(&file.path)).unwrap().into_parts();
            let reader = parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder::try_new(content).unwrap();
            for key in table.keys() {
                assert!(reader.schema().field_with_name(key).is_err(), "{} has {key}", file.path);
            }
        }
    }
    // Our own reader finds it, among all columns or alone.
    let scan = CorpusScan::open(&path).unwrap();
    let file = &manifest.files(CorpusTable::Scenarios)[0];
    for columns in [None, Some(["place"].as_slice())] {
        let batch = scan.batches(CorpusTable::Scenarios, file, columns).unwrap().next().unwrap().unwrap();
        let columns = Columns::of_batch(&batch, &path);
        assert_eq!(Some(columns.text("place", 0).unwrap()), file.partition.place.as_deref());
    }
}

#[test]
fn a_corpus_without_scenarios_has_its_columns() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, _) = store_and_records(store_dir.path());
    let manifest = CorpusWriter::create(dir.path(), &store).unwrap().finish(&CorpusNotes::default()).unwrap();
    assert_eq!((manifest.n_scenarios, manifest.all_files().count()), (0, 5));
    assert!(CorpusReader::open(dir.path()).unwrap().is_empty());
    // pyarrow and pandas cannot read a table in which no partition has a value.
    let scenarios = &manifest.files(CorpusTable::Scenarios)[0];
    assert_eq!(scenarios.path, "scenarios/behavior=none/place=none/part-00000.parquet");
}

#[test]
fn places_that_readers_take_for_something_else_stand_beside_a_word() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, mut records) = store_and_records(store_dir.path());
    let files_of = |manifest: &CorpusManifest, table: CorpusTable| -> Vec<(Option<String>, u64)> {
        manifest.files(table).iter().map(|file| (file.partition.place.clone(), file.n_rows)).collect()
    };
    for (places, has_word) in [(["001", "2024-01-01"], false), (["1e5", "True"], false), (["001", "MIA"], true)] {
        for (i, record) in records.iter_mut().enumerate() {
            places[i % 2].clone_into(&mut record.scenario.scene.source.place);
        }
        let path = dir.path().join(places[1]);
        let mut writer = CorpusWriter::create(&path, &store).unwrap();
        writer.write_scenarios(&records).unwrap();
        let manifest = writer.finish(&CorpusNotes::default()).unwrap();
        for table in [CorpusTable::Scenarios, CorpusTable::Tracks] {
            let without_rows = files_of(&manifest, table).into_iter().filter(|(_, n_rows)| *n_rows == 0);
            let expected = if has_word { vec![] } else { vec![(Some("none".to_owned()), 0)] };
            assert_eq!(without_rows.collect::<Vec<_>>(), expected, "{places:?}");
        }
        let columns: BTreeSet<String> = manifest
            .files(CorpusTable::Scenarios)
            .iter()
            .map(|file| {
                let (content, _) = fs_err::File::open(path.join(&file.path)).unwrap().into_parts();
                let reader = parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder::try_new(content).unwrap();
                format!("{:?}", reader.schema())
            })
            .collect();
        assert_eq!(columns.len(), 1, "all files have the same columns, those of parameters, too");
        let read = CorpusReader::open(&path).unwrap();
        assert_eq!(read.len(), records.len());
        assert!(places.contains(&read.scenario(0).unwrap().scenario.scene.source.place.as_str()));
    }
}

#[test]
fn an_interrupted_corpus_makes_place_and_files_of_others_do_not() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    let corpus = dir.path().join("corpus");
    keep_list(dir.path()).unwrap();
    write(&corpus, &store, &records, 33);
    let other: Vec<ScenarioRecord> = records.into_iter().filter(|record| record.requested_behavior.is_none()).collect();
    let manifest = write(&corpus, &store, &other, 33);
    let n_files = manifest.all_files().count() + 2;
    assert_eq!(folder_bytes(&corpus).len(), n_files, "the files of the manifest, itself and the card");

    let thesis = corpus.join("tracks/thesis.doc");
    fs_err::write(&thesis, "years of work").unwrap();
    let before = folder_bytes(&corpus);
    let error = CorpusWriter::create(&corpus, &store).err().unwrap().to_string();
    assert!(error.contains("thesis.doc"), "{error}");
    assert!(folder_bytes(&corpus) == before);
}

#[test]
fn damage_is_found() {
    let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, records) = store_and_records(store_dir.path());
    let manifest = write(dir.path(), &store, &records, 33);
    for file in manifest.all_files() {
        let path = dir.path().join(&file.path);
        let whole = fs_err::read(&path).unwrap();
        let mut changed = whole.clone();
        changed[whole.len() / 2] ^= 1;
        for damaged in [&whole[..whole.len() - 1], &changed] {
            fs_err::write(&path, damaged).unwrap();
            let error = CorpusReader::open(dir.path()).err().unwrap().to_string();
            assert!(error.contains(&file.path) && error.contains("is damaged"), "{error}");
        }
        fs_err::remove_file(&path).unwrap();
        let error = CorpusReader::open(dir.path()).err().unwrap().to_string();
        assert!(error.contains(&file.path) && error.contains("the file is missing"), "{error}");
        fs_err::write(&path, &whole).unwrap();
    }
    CorpusReader::open(dir.path()).unwrap();
}
