//! Are corpora read, do the tools work from the command line, and do the example queries run?

use crate::skipped::skipped;
use crate::support::{Workspace, djinn, python};
use djinn::store::{CorpusManifest, CorpusReader, CorpusTable};
use std::collections::BTreeSet;
use std::path::Path;

const CORPUS: &str = "tests/fixtures/corpus/cut_ins";

#[test]
fn a_corpus_is_read_and_one_of_another_version_is_refused() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(CORPUS);
    let reader = CorpusReader::open(&folder).unwrap();
    assert_eq!((reader.len(), reader.manifest().n_verified), (7, 6));
    for i in 0..reader.len() {
        let record = reader.scenario(i).unwrap();
        assert!(record.scenario.scene.tracks.len() >= 2 && !record.scenario.scene.lanes.is_empty());
        assert_eq!(record.main_event().is_some(), record.verified);
        assert!(
            reader.recorded_tracks(&record.scenario.scene.id, record.scenario.scene.n_timesteps).unwrap().is_some()
        );
    }
    assert!(reader.metrics().unwrap().iter().any(|row| row.scenario_id.is_some()));
    let checked = djinn(&["corpus", "validate", CORPUS]).expect(0).stdout;
    assert!(checked.contains("whole: 0 errors"), "{checked}");
    assert!(djinn(&["inspect", CORPUS]).expect(0).stdout.starts_with("corpus"));
    let n_bytes: u64 = reader.manifest().n_bytes();
    assert!(n_bytes < 300_000, "{CORPUS} has {n_bytes} bytes: fixtures must be small");
    for table in CorpusTable::ALL {
        assert_eq!(reader.manifest().tables[table.name()].schema, table.schema().id(), "write the fixture anew");
    }

    let workspace = Workspace::new();
    fs_err::create_dir(workspace.path("other")).unwrap();
    let manifest = fs_err::read_to_string(folder.join("manifest.json")).unwrap();
    let other = manifest.replace("\"corpus.v1\"", "\"corpus.v0\"");
    fs_err::write(workspace.path("other/manifest.json"), other).unwrap();
    let error = CorpusManifest::read(&workspace.path("other")).unwrap_err().to_string();
    assert!(error.contains("`corpus.v0`, expected `corpus.v1`"), "{error}");
}

#[test]
fn the_tools_work_from_the_command_line() {
    let workspace = Workspace::new();
    let (verified, two) = (workspace.arg("verified"), workspace.arg("two"));
    let outcome = djinn(&["corpus", "filter", CORPUS, "--where", "verified", "--out", &verified]).expect(0);
    assert!(outcome.stdout.is_empty() && outcome.stderr.contains("6 scenarios (6 verified) of "), "{}", outcome.stderr);
    djinn(&["corpus", "filter", &verified, "--top", "1", "--by", "gap_m", "--out", &two]).expect(0);
    let card = fs_err::read_to_string(workspace.path("two/README.md")).unwrap();
    assert!(card.contains("then filtered where verified from corpus"), "{card}");
    assert!(card.contains("then filtered where gap_m is one of the 1 greatest"), "{card}");

    // Mistakes are the user's, and say what to do.
    for (args, advice) in [
        (vec!["corpus", "filter", CORPUS, "--where", "gap < 5", "--out", "x"], "did you mean"),
        (vec!["corpus", "filter", CORPUS, "--where", "verified", "--out", &two], "choose a new folder"),
        (vec!["corpus", "merge", CORPUS, "--out", "x"], "at least two corpora"),
        (vec!["corpus", "merge", CORPUS, "scripts", "--out", "x"], "is not a corpus"),
        (vec!["corpus", "filter", CORPUS, "--top", "3", "--by", "place", "--out", "x"], "it holds no numbers"),
        (vec!["corpus", "validate", "scripts"], "is not a corpus"),
    ] {
        let outcome = djinn(&args).expect(1);
        assert!(outcome.stderr.contains(advice), "{args:?}: {}", outcome.stderr);
    }

    // A damaged corpus is reported as such, with its faults.
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

/// A query that needs a Python package that is not here is skipped, and reported; an error of a query fails the test,
/// and so does a missing Python.
#[test]
fn the_example_queries_run() {
    let stdout = python(&["scripts/check_readme_queries.py", CORPUS]);
    assert!(!stdout.is_empty());
    let missing: BTreeSet<&str> = stdout.lines().filter_map(|line| line.strip_prefix("skipped: ")).collect();
    missing.iter().for_each(|why| skipped("python-packages", why));
}
