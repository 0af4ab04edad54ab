//! Do merge and filter keep the right scenarios, and reject invalid requests?

use super::testing::{AnyMap, recorded, records, write, write_in_files_of};
use super::*;
use crate::files;
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::store::testing::folder_bytes;
use crate::store::{CorpusManifest, CorpusNotes, CorpusReader, CorpusScan, CorpusTable, CorpusWriter};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn ids(dir: &Path) -> BTreeSet<String> {
    CorpusReader::open(dir).unwrap().scenario_ids().unwrap().map(str::to_owned).collect()
}

fn filtered(dir: &Path, conditions: &[&str], out: &Path) -> Result<CopyOutcome> {
    let conditions: Vec<Condition> = conditions.iter().map(|text| text.parse().unwrap()).collect();
    filter(dir, &FilterOptions { conditions, ..FilterOptions::default() }, out, &Silent)
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A corpus of the scenarios of these scenes.
    fn corpus(&self, name: &str, seeds: std::ops::Range<u64>) -> PathBuf {
        write(&self.path(name), &records(seeds));
        self.path(name)
    }
}

/// Everything of `expected` is in the corpus, as it was, with its recordings, and nothing else.
fn assert_holds(dir: &Path, expected: &[ScenarioRecord]) {
    let reader = CorpusReader::open(dir).unwrap();
    assert_eq!(reader.len(), expected.len());
    for record in expected {
        let found = reader.scenario(reader.position(&record.scenario.id).unwrap()).unwrap();
        assert_eq!(found, *record);
        let recording = recorded(record.scenario.scene.source.case_id.parse().unwrap());
        let tracks = reader.recorded_tracks(&recording.id, recording.n_timesteps).unwrap();
        assert_eq!(tracks.unwrap(), recording.tracks);
    }
    let scenes: BTreeSet<&str> = expected.iter().map(|record| record.scenario.scene.id.0.as_str()).collect();
    assert_eq!(reader.manifest().n_recordings, scenes.len() as u64);
    let of_scenarios = reader.metrics().unwrap();
    assert_eq!(of_scenarios.len(), expected.len(), "one value a scenario, and no aggregate");
    let report = validate(dir, &Silent).unwrap();
    assert_eq!((report.n_damages, report.n_remarks), (0, 0), "{:?}", report.findings);
}

#[test]
fn a_merge_holds_everything_once() {
    let folder = Folder::new();
    let (a, b) = (folder.corpus("a", 0..9), folder.corpus("b", 6..14));
    let outcome = merge(&[a.clone(), b.clone()], &folder.path("out"), &Silent).unwrap();
    // Scenes 6, 7 and 8 are in both, with two scenarios each.
    assert_eq!((outcome.n_duplicates, outcome.n_differing_recordings, outcome.n_aggregates_left_out), (6, 0, 2));
    assert_holds(&folder.path("out"), &records(0..14));
    let manifest = outcome.manifest;
    assert_eq!((manifest.n_scenarios, manifest.n_maps, manifest.history.len()), (28, 1, 1));
    assert_eq!(manifest.notes["pipeline"], "test");
    assert!(manifest.sources["argoverse1"].contains("CC BY-NC-SA 4.0"));
    assert!(!manifest.sources["argoverse1"].contains("Also"));
    // Equal corpora give equal bytes, and the parts that they were cut into do not matter to the set.
    merge(&[a, b], &folder.path("again"), &Silent).unwrap();
    assert!(folder_bytes(&folder.path("out")) == folder_bytes(&folder.path("again")));
}

#[test]
fn a_merge_with_nothing_new_is_what_it_was_but_for_history_and_aggregates() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..9);
    merge(&[a.clone(), a.clone()], &folder.path("out"), &Silent).unwrap();
    let (before, after) = (folder_bytes(&a), folder_bytes(&folder.path("out")));
    for (file, bytes) in before.iter().filter(|(file, _)| file.contains('/')) {
        assert!(after[file] == *bytes, "{file} differs");
    }
    assert_eq!(before.len(), after.len());
}

#[test]
fn recordings_are_the_same_wherever_batches_break() {
    let folder = Folder::new();
    // More rows at one place than are read at a time, so that scenes lie across the break in one corpus and not in the
    // other.
    let (a, b) = (folder.corpus("a", 0..330), folder.corpus("b", 100..330));
    let n_rows = |dir: &Path| CorpusManifest::read(dir).unwrap().tables["recordings"].files[1].n_rows;
    assert!(n_rows(&a) > 8192 && n_rows(&b) < 8192, "{} {}", n_rows(&a), n_rows(&b));
    let outcome = merge(&[a.clone(), b], &folder.path("out"), &Silent).unwrap();
    assert_eq!((outcome.n_duplicates, outcome.n_differing_recordings), (460, 0));
    let tables = |dir: &Path| CorpusManifest::read(dir).unwrap().tables;
    assert_eq!(tables(&folder.path("out"))["recordings"], tables(&a)["recordings"]);
}

#[test]
fn a_corpus_of_many_files_is_read_judged_and_copied_as_one_of_few() {
    let folder = Folder::new();
    let (few, many, copied) = (folder.corpus("few", 0..40), folder.path("many"), folder.path("copied"));
    let manifest = write_in_files_of(7, &many, &records(0..40));
    let n_units: Vec<usize> = manifest.scenarios_by_partition.iter().map(|count| count.n_scenarios as usize).collect();
    for table in [CorpusTable::Scenarios, CorpusTable::Tracks] {
        assert_eq!(manifest.files(table).len(), n_units.iter().map(|n| n.div_ceil(7)).sum::<usize>());
    }
    // Every third of 40 scenes is at one place, the others at the other.
    assert_eq!(manifest.files(CorpusTable::Recordings).len(), 14_usize.div_ceil(7) + 26_usize.div_ceil(7));
    assert_eq!(manifest.files(CorpusTable::Scenarios)[0].n_rows, 7);

    let [of_few, of_many] = [&few, &many].map(|dir| CorpusReader::open(dir).unwrap());
    assert!(of_few.scenario_ids().unwrap().eq(of_many.scenario_ids().unwrap()));
    assert!((0..of_few.len()).all(|i| of_few.scenario(i).unwrap() == of_many.scenario(i).unwrap()));
    let report = validate(&many, &Silent).unwrap();
    assert_eq!((report.n_damages, report.n_remarks), (0, 0), "{:?}", report.findings);
    filtered(&many, &["n_timesteps > 0"], &copied).unwrap();
    assert_holds(&copied, &records(0..40));
    let (before, after) = (folder_bytes(&few), folder_bytes(&copied));
    for (file, bytes) in before.iter().filter(|(file, _)| file.contains('/')) {
        assert!(after[file] == *bytes, "{file} differs");
    }
}

#[test]
fn different_scenarios_of_one_id_are_refused_and_nothing_is_left() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..5);
    let mut changed = records(3..6);
    changed[1].scenario.provenance.seed = 7;
    write(&folder.path("b"), &changed);
    let error = merge(&[a.clone(), folder.path("b")], &folder.path("out"), &Silent).unwrap_err();
    assert!(matches!(&error, Error::Conflict { id, .. } if *id == changed[1].scenario.id), "{error}");
    // A state that differs counts as much as a column.
    let mut changed = records(3..6);
    let track = &mut changed[0].scenario.scene.tracks[0];
    let mut states = track.trajectory.entries().to_vec();
    states.iter_mut().flatten().for_each(|state| state.velocity.x += 1.0);
    track.trajectory = crate::scene::Trajectory::new(states);
    write(&folder.path("c"), &[changed.remove(0)].map(as_stored));
    assert!(matches!(merge(&[a, folder.path("c")], &folder.path("out"), &Silent), Err(Error::Conflict { .. })));
    assert!(!folder.path("out").exists() && !folder.path("out.partial").exists());
}

fn as_stored(mut record: ScenarioRecord) -> ScenarioRecord {
    record.scenario.scene = crate::store::as_stored(&record.scenario.scene);
    record
}

#[test]
fn different_maps_of_one_name_are_refused() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..3);
    let maps = AnyMap(6);
    let mut writer = CorpusWriter::create(&folder.path("b"), &maps).unwrap();
    writer.write_scenarios(&records(5..6)).unwrap();
    writer.finish(&CorpusNotes::default()).unwrap();
    let error = merge(&[a, folder.path("b")], &folder.path("out"), &Silent).unwrap_err();
    assert!(matches!(&error, Error::MapConflict { id, .. } if id == "PIT"), "{error}");
}

#[test]
fn recordings_that_differ_are_counted_and_the_first_comes() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..3);
    let maps = AnyMap(5);
    let mut writer = CorpusWriter::create(&folder.path("b"), &maps).unwrap();
    writer.write_scenarios(&records(1..2)).unwrap();
    let mut scene = recorded(1);
    scene.tracks.truncate(2);
    writer.write_recording(&scene).unwrap();
    writer.finish(&CorpusNotes::default()).unwrap();
    let outcome = merge(&[a, folder.path("b")], &folder.path("out"), &Silent).unwrap();
    assert_eq!((outcome.n_duplicates, outcome.n_differing_recordings), (2, 1));
    assert_holds(&folder.path("out"), &records(0..3));
}

#[test]
fn a_filter_keeps_what_fulfils_all_conditions() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..40);
    let keeps = |record: &ScenarioRecord| record.verified && record.scenario.scene.source.place == "MIA";
    let expected: Vec<ScenarioRecord> = records(0..40).into_iter().filter(keeps).collect();
    assert!(expected.len() > 5);
    let outcome = filtered(&a, &["verified", "place = MIA"], &folder.path("out")).unwrap();
    assert_holds(&folder.path("out"), &expected);
    assert!(outcome.manifest.history[0].starts_with("filtered where verified and place = MIA from corpus "));
    let card = fs_err::read_to_string(folder.path("out/README.md")).unwrap();
    assert!(card.contains("then filtered where verified and place = MIA"));

    // Parameters of events are columns; the gap of the verified sample, number 1, is 6 m.
    filtered(&a, &["gap_m < 6.5", "gap_m >= 6"], &folder.path("gap")).unwrap();
    let found = ids(&folder.path("gap"));
    assert_eq!(found, records(0..40).iter().filter(|r| r.verified).map(|r| r.scenario.id.clone()).collect());
    filtered(&a, &["gap_m < 6"], &folder.path("none")).unwrap();
    assert!(CorpusReader::open(&folder.path("none")).unwrap().is_empty());
    // A table without rows still has its columns.
    let columns = |name: &str| CorpusScan::open(&folder.path(name)).unwrap().scenario_schema().unwrap();
    assert!(columns("none").field_with_name("gap_m").is_ok());
    assert_eq!(columns("none"), columns("gap"));
    assert!(matches!(filtered(&a, &["gap < 6"], &folder.path("wrong")), Err(Error::UnknownColumn { .. })));
    assert!(!folder.path("wrong").exists());
    assert!(matches!(filtered(&a, &["verified"], &folder.path("out")), Err(Error::Files(files::Error::Exists { .. }))));
}

#[test]
fn parts_of_a_corpus_merge_into_the_whole() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..30);
    let (yes, no) = (folder.path("yes"), folder.path("no"));
    filtered(&a, &["verified"], &yes).unwrap();
    filtered(&a, &["verified = false"], &no).unwrap();
    merge(&[no, yes], &folder.path("out"), &Silent).unwrap();
    assert_holds(&folder.path("out"), &records(0..30));
}

#[test]
fn damaged_and_foreign_folders_are_refused_before_anything_is_written() {
    let folder = Folder::new();
    let (a, b) = (folder.corpus("a", 0..3), folder.corpus("b", 3..6));
    let file = b.join("lanes.parquet");
    let bytes = fs_err::read(&file).unwrap();
    fs_err::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    let error = merge(&[a.clone(), b.clone()], &folder.path("out"), &Silent).unwrap_err().to_string();
    assert!(error.contains("lanes.parquet is damaged"), "{error}");
    fs_err::remove_file(b.join("manifest.json")).unwrap();
    let error = merge(&[a.clone(), b], &folder.path("out"), &Silent).unwrap_err().to_string();
    assert!(error.contains("did not finish"), "{error}");
    let error = merge(&[a, folder.0.path().to_owned()], &folder.path("out"), &Silent).unwrap_err().to_string();
    assert!(error.contains("is not a corpus"), "{error}");
    assert!(!folder.path("out").exists() && !folder.path("out.partial").exists());
}

#[test]
fn a_filter_takes_a_list_of_beginnings_and_the_ends_of_an_order() {
    let folder = Folder::new();
    let a = folder.corpus("a", 0..8);
    let all = ids(&a);
    let take = |options: FilterOptions, name: &str| {
        filter(&a, &options, &folder.path(name), &Silent).map(|_| ids(&folder.path(name)))
    };
    let listed = |ids: &[&str]| FilterOptions {
        ids: Some(ids.iter().map(|id| (*id).to_owned()).collect()),
        ..FilterOptions::default()
    };
    let first = all.last().unwrap();
    assert_eq!(take(listed(&[first]), "one").unwrap(), BTreeSet::from([first.clone()]));
    // If other ids begin alike, a beginning is not enough.
    let beginning = &first[..first.len() - 1];
    let reader = CorpusReader::open(&a).unwrap();
    assert!(matches!(take(listed(&[beginning]), "ambiguous"), Err(Error::Usage(_))));
    assert!(reader.position(beginning).is_err());
    let alone = folder.path("one");
    filter(&alone, &listed(&[beginning]), &folder.path("abbreviated"), &Silent).unwrap();
    assert_eq!(ids(&folder.path("abbreviated")), BTreeSet::from([first.clone()]));
    assert_eq!(CorpusReader::open(&alone).unwrap().position(beginning).unwrap(), 0);
    for unknown in ["", "no such scenario"] {
        assert!(matches!(take(listed(&[unknown]), "none"), Err(Error::Usage(_))), "{unknown}");
        assert!(reader.position(unknown).is_err());
    }
    let top = |n, column: &str, least| Some(Top { n, column: column.to_owned(), least });
    let options = |least| FilterOptions { top: top(8, "sample_idx", least), ..FilterOptions::default() };
    let of = |sample: usize| {
        let own = records(0..8).into_iter().filter(|record| record.scenario.provenance.sample_idx == sample);
        own.map(|record| record.scenario.id).collect::<BTreeSet<_>>()
    };
    assert_eq!(take(options(true), "least").unwrap(), of(0));
    assert_eq!(take(options(false), "greatest").unwrap(), of(1));
    let by_text = FilterOptions { top: top(1, "place", false), ..FilterOptions::default() };
    assert!(matches!(take(by_text, "text"), Err(Error::Usage(_))));
    let unknown = FilterOptions { top: top(1, "samples_idx", false), ..FilterOptions::default() };
    assert!(matches!(take(unknown, "unknown"), Err(Error::UnknownColumn { .. })));
    let nothing = filter(&a, &FilterOptions::default(), &folder.path("all"), &Silent);
    assert!(matches!(nothing, Err(Error::Usage(_))) && !folder.path("all").exists());
}
