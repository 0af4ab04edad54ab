//! Are corpora of every version read, do the tools work from the command line, and do the example queries run?

use crate::skipped::skipped;
use crate::support::{Workspace, djinn, python};
use djinn::store::{CorpusManifest, CorpusReader, CorpusTable};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const FLAT: &str = "tests/fixtures/corpus/corpus.v1_scenario.v3";
const PARTITIONED: &str = "tests/fixtures/corpus/corpus.v2_scenario.v3";
/// The present version, whose columns the documents may name.
const PRESENT: &str = "tests/fixtures/corpus/corpus.v2_scenario.v6";

/// The corpora of every version; tests/fixtures/corpus/README.md says how to add one.
fn fixtures() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/corpus");
    let entries = fs_err::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut folders: Vec<PathBuf> = entries.filter(|path| path.is_dir()).collect();
    folders.sort();
    folders
}

#[test]
fn corpora_of_every_version_are_read() {
    for folder in fixtures() {
        let reader = CorpusReader::open(&folder).unwrap();
        assert!(reader.len() == 7 && reader.manifest().n_verified >= 2, "{}", folder.display());
        for i in 0..reader.len() {
            let record = reader.scenario(i).unwrap();
            assert!(record.scenario.scene.tracks.len() >= 2 && !record.scenario.scene.lanes.is_empty());
            assert_eq!(record.main_event().is_some(), record.verified);
            let recorded =
                reader.recorded_tracks(&record.scenario.scene.id, record.scenario.scene.n_timesteps).unwrap();
            assert_eq!(recorded.is_some(), reader.manifest().n_recordings > 0);
        }
        assert!(reader.metrics().unwrap().iter().any(|row| row.scenario_id.is_some()));
        let path = folder.to_str().unwrap();
        let checked = djinn(&["corpus", "validate", path]).expect(0).stdout;
        assert!(checked.contains("whole: 0 errors"), "{checked}");
        assert!(djinn(&["inspect", path]).expect(0).stdout.starts_with("corpus"));
        let n_bytes: u64 = reader.manifest().n_bytes();
        assert!(n_bytes < 300_000, "{path} has {n_bytes} bytes: fixtures must be small");
    }
}

#[test]
fn the_present_version_has_a_fixture() {
    let is_present = |folder: &PathBuf| {
        let manifest = CorpusManifest::read(folder).unwrap();
        CorpusTable::ALL
            .iter()
            .all(|table| manifest.tables.get(table.name()).is_some_and(|entry| entry.schema == table.schema().id()))
    };
    assert!(
        fixtures().iter().any(is_present),
        "no corpus in tests/fixtures/corpus has the present tables: add one as its README.md says"
    );
}

#[test]
fn an_old_corpus_holds_the_same_as_the_new_one() {
    let workspace = Workspace::new();
    let (out, copy) = (workspace.arg("both"), workspace.arg("copy"));
    let outcome = djinn(&["corpus", "merge", FLAT, PARTITIONED, "--out", &out]).expect(0);
    assert!(outcome.stderr.contains("7 scenarios were in several corpora and were written once"), "{}", outcome.stderr);
    // The recordings come from the one that has them. Tables are written with the present descriptions of columns.
    djinn(&["corpus", "filter", PARTITIONED, "--where", "scenario_id is present", "--out", &copy]).expect(0);
    let manifest = CorpusManifest::read(Path::new(&out)).unwrap();
    let present = CorpusManifest::read(Path::new(&copy)).unwrap();
    assert_eq!((manifest.n_scenarios, manifest.n_recordings), (7, present.n_recordings));
    assert_eq!(manifest.tables["tracks"], present.tables["tracks"]);
    assert_eq!(manifest.tables["recordings"], present.tables["recordings"]);
    let same = djinn(&["corpus", "diff", FLAT, PARTITIONED, "--json"]).expect(0).stdout;
    let same: serde_json::Value = serde_json::from_str(&same).unwrap();
    assert_eq!((same["n_same"].as_u64(), same["n_changed"].as_u64()), (Some(7), Some(0)));
}

#[test]
fn the_tools_work_from_the_command_line() {
    let workspace = Workspace::new();
    let (verified, two) = (workspace.arg("verified"), workspace.arg("two"));
    let outcome = djinn(&["corpus", "filter", PARTITIONED, "--where", "verified", "--out", &verified]).expect(0);
    assert!(outcome.stdout.is_empty() && outcome.stderr.contains("2 scenarios (2 verified) of "), "{}", outcome.stderr);
    djinn(&["corpus", "sample", &verified, "--n", "1", "--seed", "3", "--out", &two]).expect(0);
    let shown = djinn(&["corpus", "diff", &verified, &two]).expect(0).stdout;
    assert!(shown.contains("same: 1, changed: 0, only in A: 1, only in B: 0"), "{shown}");
    let card = fs_err::read_to_string(workspace.path("two/README.md")).unwrap();
    assert!(
        card.contains("then filtered where verified from corpus") && card.contains("then sampled 1 with seed 3"),
        "{card}"
    );
    let part = fs_err::read_dir(workspace.path("two/tracks/behavior=cut_in")).unwrap().next().unwrap().unwrap().path();
    let part = djinn(&["inspect", part.join("part-00000.parquet").to_str().unwrap()]).expect(0).stdout;
    assert!(part.contains("table: tracks") && part.contains("behavior: cut_in"), "{part}");

    // Mistakes are the user's, and say what to do.
    for (args, advice) in [
        (vec!["corpus", "filter", PARTITIONED, "--where", "gap < 5", "--out", "x"], "did you mean"),
        (vec!["corpus", "filter", PARTITIONED, "--where", "verified", "--out", &two], "choose a new folder"),
        (vec!["corpus", "merge", PARTITIONED, "--out", "x"], "at least two corpora"),
        (vec!["corpus", "merge", PARTITIONED, "scripts", "--out", "x"], "is not a corpus"),
        (vec!["corpus", "sample", PARTITIONED, "--n", "3", "--by", "gap_m", "--out", "x"], "expected a column of text"),
        (vec!["corpus", "validate", "scripts"], "is not a corpus"),
    ] {
        let outcome = djinn(&args).expect(1);
        assert!(outcome.stderr.contains(advice), "{args:?}: {}", outcome.stderr);
    }

    // A damaged corpus is told as such, with what is wrong with it.
    let lanes = workspace.path("two/lanes.parquet");
    let bytes = fs_err::read(&lanes).unwrap();
    fs_err::write(&lanes, &bytes[..100]).unwrap();
    let outcome = djinn(&["corpus", "validate", &two]).expect(1);
    assert!(outcome.stdout.contains("damage (checksum): lanes.parquet: "), "{}", outcome.stdout);
    assert!(outcome.stderr.contains("is damaged"), "{}", outcome.stderr);
    let json = djinn(&["corpus", "validate", &two, "--json"]).expect(1).stdout;
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(json["n_damages"].as_u64() > Some(1) && json["by_check"]["checksum"] == 1, "{json}");
}

/// What needs a Python package that is not here is skipped, and told; an error of a query fails it, and so does a missing Python.
#[test]
fn the_example_queries_run() {
    let stdout = python(&["scripts/check_readme_queries.py", PRESENT]);
    assert!(!stdout.is_empty());
    let missing: BTreeSet<&str> = stdout.lines().filter_map(|line| line.strip_prefix("skipped: ")).collect();
    missing.iter().for_each(|why| skipped("python-packages", why));
}
