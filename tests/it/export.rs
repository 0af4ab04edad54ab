//! Does `djinn export` write every format from a corpus, refuse what it must, and lead back to where it came from?

use crate::support::{Outcome, Workspace, assert_same, djinn, files, json};
use djinn::export::ExportFormat;
use std::collections::BTreeMap;
use std::path::Path;

/// The rows of a table by the names of its columns.
fn rows(path: &Path) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::ReaderBuilder::new().delimiter(b'\t').from_path(path).unwrap();
    reader.deserialize().map(Result::unwrap).collect()
}

/// One corpus for all questions: it takes a whole run to make.
#[test]
fn a_corpus_becomes_every_format_and_what_cannot_be_is_refused() {
    let workspace = Workspace::new();
    workspace.run("out", &[]).expect(0);
    let corpus = workspace.run_folder("out").join("corpus");
    let manifest = json(&corpus.join("manifest.json"));
    let n_scenarios = manifest["n_scenarios"].as_u64().unwrap() as usize;
    let export = |format: &str, out: &str, more: &[&str]| -> Outcome {
        let out = workspace.arg(out);
        djinn(&[&["export", format, corpus.to_str().unwrap(), "--out", &out], more].concat())
    };

    for format in ExportFormat::ALL.map(ExportFormat::name) {
        let outcome = export(format, format, &[]).expect(0);
        assert_eq!(outcome.stdout, "");
        assert!(outcome.stderr.contains("non-commercial use"), "{}", outcome.stderr);
        let folder = workspace.path(format);
        let index = rows(&folder.join("index.tsv"));
        assert_eq!(index.len(), n_scenarios, "{format}");
        assert!(index.iter().all(|row| folder.join(&row["file"]).exists()));
        let tracks = rows(&folder.join("tracks.tsv"));
        let is_ego = |row: &&BTreeMap<String, String>| {
            row["is_ego"] == "true" && row["left_out"].is_empty() != (format == "commonroad")
        };
        assert_eq!(tracks.iter().filter(is_ego).count(), n_scenarios, "{format}");
        // It is the one to whom the event happens, where there is one.
        let role_of_ego = |id: &str| {
            let ego = tracks.iter().find(|row| row["scenario_id"] == id && row["is_ego"] == "true");
            ego.map_or("", |row| row["event_role"].as_str())
        };
        let verified: Vec<_> = index.iter().filter(|row| row["verified"] == "true").collect();
        assert!(verified.iter().all(|row| role_of_ego(&row["scenario_id"]) == "ego"), "{format}");
        let notice = fs_err::read_to_string(folder.join("NOTICE.txt")).unwrap();
        assert!(notice.contains("Sources and terms"), "{notice}");
        assert!(notice.contains("interaction: INTERACTION dataset"), "{notice}");
        let report = json(&folder.join("export.json"));
        let found = (report["format"].as_str(), report["n_scenarios"].as_u64());
        assert_eq!(found, (Some(format), Some(n_scenarios as u64)));
        let seen = report["n_tracks"].as_u64();
        assert_eq!(seen, Some(tracks.iter().filter(|row| row["left_out"].is_empty()).count() as u64));
        assert_eq!(report["assumed"]["no_subject"].as_u64(), Some((n_scenarios - verified.len()) as u64));
        // A second export has the same bytes.
        export(format, "again", &["-q"]).expect(0);
        assert_same(&files(&folder), &files(&workspace.path("again")));
        fs_err::remove_dir_all(workspace.path("again")).unwrap();
    }

    // Our own readers take the cases and scenarios for what they are.
    export("commonroad", "replayed", &["--replay-ego"]).expect(0);
    for (dataset, folder, settings) in [
        ("interaction", "interaction", ["ingest.maps=none", "ingest.n_history=10", "ingest.n_future=30"]),
        ("womd", "womd", ["ingest.maps=required", "ingest.n_history=10", "ingest.n_future=30"]),
        // An exported scenario begins at present.
        ("commonroad", "replayed", ["ingest.maps=required", "ingest.n_history=1", "ingest.n_future=30"]),
    ] {
        let (cases, scenes) = (workspace.arg(folder), format!("{}_ingested", workspace.arg(dataset)));
        let [maps, past, future] = settings;
        let settings = ["--set", maps, "--set", past, "--set", future, "--output", &scenes];
        let outcome = djinn(&[&["ingest", &cases, "--dataset", dataset][..], &settings].concat()).expect(0);
        assert!(outcome.stderr.contains(&format!("ingest: {n_scenarios} scenes")), "{}", outcome.stderr);
    }

    // Selections.
    let index = rows(&workspace.path("openlabel").join("index.tsv"));
    let ids = |out: &str| -> Vec<String> {
        rows(&workspace.path(out).join("index.tsv")).iter().map(|row| row["scenario_id"].clone()).collect()
    };
    export("openlabel", "few", &["--limit", "2"]).expect(0);
    assert_eq!(ids("few"), [index[0]["scenario_id"].as_str(), &index[1]["scenario_id"]]);
    // Two by their ids, in the corpus's order.
    let (third, first) = (index[2]["scenario_id"].as_str(), index[0]["scenario_id"].as_str());
    export("openlabel", "two", &["--scenario", third, "--scenario", first]).expect(0);
    assert_eq!(ids("two"), [first, third]);
    export("openlabel", "sweep", &["--sweep", "as_recorded"]).expect(0);
    assert_eq!(ids("sweep").len(), index.iter().filter(|row| row["sweep"] == "as_recorded").count());
    for verdict in ["verified", "accepted"] {
        let expected: Vec<&str> =
            index.iter().filter(|row| row[verdict] == "true").map(|row| row["scenario_id"].as_str()).collect();
        let option = format!("--only-{verdict}");
        if expected.is_empty() {
            let outcome = export("openlabel", verdict, &[&option]).expect(1);
            let message = format!("none of the {n_scenarios} scenarios");
            assert!(outcome.stderr.contains(&message), "{}", outcome.stderr);
            assert!(outcome.stderr.contains(&format!("is {verdict}")), "{}", outcome.stderr);
        } else {
            export("openlabel", verdict, &[&option]).expect(0);
            assert_eq!(ids(verdict), expected);
        }
    }
    let n_verified = index.iter().filter(|row| row["verified"] == "true").count();
    assert_eq!(Some(n_verified as u64), manifest["n_verified"].as_u64());

    // CommonRoad leaves the ego to a planner by default, OpenSCENARIO on request.
    for (format, option, motion) in [
        ("commonroad", None, "free"),
        ("commonroad", Some("--free-ego"), "free"),
        ("commonroad", Some("--replay-ego"), "replayed"),
        ("openscenario", None, "replayed"),
        ("openscenario", Some("--free-ego"), "free"),
        ("interaction", Some("--replay-ego"), "replayed"),
    ] {
        let out = format!("{format}_{}", option.unwrap_or("as_usual"));
        export(format, &out, &[&["--limit", "1"], option.as_slice()].concat()).expect(0);
        assert_eq!(json(&workspace.path(&out).join("export.json"))["ego_motion"].as_str(), Some(motion), "{out}");
        let tracks = rows(&workspace.path(&out).join("tracks.tsv"));
        let left_out = &tracks.iter().find(|row| row["is_ego"] == "true").unwrap()["left_out"];
        assert_eq!(left_out == "ego_is_free", format == "commonroad" && motion == "free", "{out}");
    }

    // An impossible export says why, and leaves nothing behind.
    for (format, out, more, message) in [
        ("openlabel", "few", vec![], "is not empty"),
        ("openlabel", "none", vec!["--scenario", "nobody"], "holds no scenario nobody"),
        ("openlabel", "none", vec!["--behavior", "left_turn"], "requested as left_turn"),
        ("interaction", "none", vec!["--free-ego"], "cannot leave the ego free"),
        ("commonroad", "none", vec!["--free-ego", "--replay-ego"], "cannot be used with"),
        ("commonroad", "none", vec!["--ego", "nobody"], "no track of that name"),
        ("opendrive", "none", vec![], "openscenario"),
        ("openlabel", "small.toml/below", vec![], "small.toml"),
    ] {
        let outcome = export(format, out, &more).expect(1);
        assert!(outcome.stderr.contains(message), "{format} {more:?}: {}", outcome.stderr);
        assert!(!workspace.path("none").exists(), "{format} {more:?}");
    }
    let missing = djinn(&["export", "openlabel", &workspace.arg("nowhere"), "--out", &workspace.arg("none")]).expect(1);
    assert!(missing.stderr.contains("pass the folder `corpus` of a run"), "{}", missing.stderr);
}
