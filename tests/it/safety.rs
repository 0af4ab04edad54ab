//! Do the commands leave alone what they did not write: recordings, files beside results, trained models, other
//! corpora?

use crate::support::{Outcome, Workspace, command, djinn, files, start, write_all};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

const RECORDINGS: &str = "tests/fixtures/recordings/argoverse1";
const MODEL: &str = "pipelines/models/simulated_places.safetensors";
const CORPUS: &str = "tests/fixtures/corpus/cut_ins";

fn put(path: &Path, text: &str) {
    fs_err::create_dir_all(path.parent().unwrap()).unwrap();
    fs_err::write(path, text).unwrap();
}

/// Demands that the command was refused for this reason, and that nothing in the workspace changed.
#[track_caller]
fn refused(workspace: &Workspace, outcome: Outcome, before: &BTreeMap<String, Vec<u8>>, parts: &[&str]) {
    let outcome = outcome.expect(1);
    for part in parts {
        assert!(outcome.stderr.contains(part), "`{part}` is not in\n{}", outcome.stderr);
    }
    assert!(files(&workspace.path("")).iter().filter(|(name, _)| !name.ends_with(".lock")).eq(before.iter()));
}

fn everything(workspace: &Workspace) -> BTreeMap<String, Vec<u8>> {
    files(&workspace.path("")).into_iter().filter(|(name, _)| !name.ends_with(".lock")).collect()
}

#[test]
fn recordings_in_the_place_of_scenes_are_left_alone() {
    let workspace = Workspace::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    write_all(&files(&root.join(RECORDINGS)), &workspace.path("scenes"));
    #[cfg(unix)]
    std::os::unix::fs::symlink("scenes", workspace.path("link")).unwrap();
    let before = everything(&workspace);
    let ingest = |input: &str, output: &str| {
        let args = ["ingest", input, "--dataset", "argoverse1", "--output", output];
        Outcome::of(command(&args).current_dir(workspace.path("")))
    };
    refused(&workspace, ingest("scenes", "."), &before, &["./scenes: it is the input inputs.0", "nothing was changed"]);
    refused(&workspace, ingest("./scenes", "scenes/.."), &before, &["it is the input"]);
    refused(&workspace, ingest(".", "out"), &before, &["it lies inside the input", "choose another output"]);
    refused(&workspace, ingest("scenes", "scenes/out"), &before, &["it lies inside the input"]);
    #[cfg(unix)]
    refused(&workspace, ingest("link", "."), &before, &["it is the input"]);
    ingest("scenes", "out").expect(0);
    assert!(before.iter().all(|(name, bytes)| fs_err::read(workspace.path(name)).unwrap() == *bytes));
    // Files of somebody in the place of scenes that were never ours.
    put(&workspace.path("full/scenes/thesis.doc"), "years of work");
    let before = everything(&workspace);
    refused(&workspace, ingest("scenes", "full"), &before, &["full/scenes: it holds thesis.doc", "move that away"]);
}

#[test]
fn a_report_leaves_figures_and_pages_of_others_alone() {
    let workspace = Workspace::new();
    let (run, out) = (workspace.arg("run"), workspace.arg("out"));
    djinn(&["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &run]).expect(0);
    put(&workspace.path("out/figures/mine.svg"), "<svg/>");
    let before = everything(&workspace);
    let report = || djinn(&["report", "--from", &run, "--output", &out]);
    refused(&workspace, report(), &before, &["out/figures: it holds mine.svg", "nothing was changed"]);
    fs_err::rename(workspace.path("out/figures"), workspace.path("out/own")).unwrap();
    put(&workspace.path("out/report.html"), "<p>mine</p>");
    let before = everything(&workspace);
    refused(&workspace, report(), &before, &["out/report.html: it holds report.html, which djinn did not write"]);
    fs_err::remove_file(workspace.path("out/report.html")).unwrap();
    report().expect(0);
    // Done again, what was put between ours is found again, and ours alone is replaced.
    put(&workspace.path("out/figures/mine.svg"), "<svg/>");
    report().expect(0);
    let before = everything(&workspace);
    let again = djinn(&["report", "--from", &run, "--output", &out, "--set", "report.n_drawn=1"]);
    refused(&workspace, again, &before, &["out/figures: it holds mine.svg"]);
}

#[test]
fn a_model_is_not_trained_over_itself() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    let train = |setting: &str| djinn(&["train", "denoiser", "--set", setting, "--output", &out]);
    train(&format!("train.denoiser.checkpoint={MODEL}")).expect(0);
    djinn(&["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &out]).expect(0);
    let before = everything(&workspace);
    for key in ["checkpoint", "start_from"] {
        for path in ["out/denoiser/model.safetensors", "out/denoiser"] {
            let outcome = train(&format!("train.denoiser.{key}={}", workspace.arg(path)));
            let parts = ["out/denoiser: it contains the input", key, "nothing was changed", "copy it elsewhere"];
            refused(&workspace, outcome, &before, &parts);
        }
    }
    // A dry run says the same.
    let setting = format!("train.denoiser.checkpoint={}", workspace.arg("out/denoiser"));
    let outcome = djinn(&["train", "denoiser", "--set", &setting, "--output", &out, "--dry-run"]);
    refused(&workspace, outcome, &before, &["it contains the input"]);
}

#[test]
fn what_is_done_again_is_told_beforehand() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    let ingest = |more: &[&str]| {
        djinn(&[&["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &out], more].concat()).expect(0)
    };
    assert!(!ingest(&[]).stderr.contains("runs again"));
    let told = ingest(&["--set", "ingest.limit=3"]).stderr;
    assert!(told.starts_with("ingest runs again: changed: ingest.limit null -> 3"), "{told}");
    let told = ingest(&["--set", "ingest.limit=3", "--redo"]).stderr;
    assert!(told.starts_with("ingest runs again: requested by --redo"), "{told}");
    let unknown = workspace.run("x", &["--redo", "frobnicate"]).expect(1).stderr;
    assert!(unknown.contains("train_denoiser"), "{unknown}");
    let absent = workspace.run("x", &["--redo", "train_baseline", "--dry-run"]).expect(1).stderr;
    assert!(absent.contains("the pipeline has no such stage"), "{absent}");
}

#[test]
fn a_kill_leaves_the_old_or_the_new() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    let args = |limit: usize| {
        let limit = format!("ingest.limit={limit}");
        ["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &out, "--set", &limit].map(str::to_owned).to_vec()
    };
    let manifests: Vec<Vec<u8>> = [8, 3]
        .map(|limit| {
            djinn(&args(limit).iter().map(String::as_str).collect::<Vec<_>>()).expect(0);
            fs_err::read(workspace.path("out/scenes/manifest.json")).unwrap()
        })
        .to_vec();
    assert_ne!(manifests[0], manifests[1]);
    for i in 0..24 {
        let args = args([8, 3][i % 2]);
        let mut child = start(&args.iter().map(String::as_str).collect::<Vec<_>>());
        std::thread::sleep(Duration::from_millis(3 * i as u64));
        child.kill().unwrap();
        child.wait().unwrap();
        let found = fs_err::read(workspace.path("out/scenes/manifest.json")).unwrap();
        assert!(manifests.contains(&found), "killed after {} ms", 3 * i);
    }
    for limit in [8, 3, 8] {
        djinn(&args(limit).iter().map(String::as_str).collect::<Vec<_>>()).expect(0);
    }
    assert_eq!(fs_err::read(workspace.path("out/scenes/manifest.json")).unwrap(), manifests[0]);
    assert!(!workspace.path("out/ingest.partial").exists());
}

#[test]
fn corpora_and_exports_are_not_written_into_what_they_read() {
    let workspace = Workspace::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    write_all(&files(&root.join(CORPUS)), &workspace.path("a"));
    put(&workspace.path("full/thesis.doc"), "years of work");
    let (a, inside, full) = (workspace.arg("a"), workspace.arg("a/sub"), workspace.arg("full"));
    let before = everything(&workspace);
    for (out, part) in
        [(&inside, "lies inside the input corpus"), (&a, "it is the input corpus"), (&full, "is not empty")]
    {
        for args in [
            vec!["corpus", "filter", &a, "--where", "verified", "--out", out],
            vec!["corpus", "merge", &a, CORPUS, "--out", out],
            vec!["export", "openlabel", &a, "--out", out],
        ] {
            refused(&workspace, djinn(&args), &before, &[part]);
        }
    }
    put(&workspace.path("mine.parquet"), "years of work");
    let before = everything(&workspace);
    let (mine, row) = (workspace.arg("mine.parquet"), workspace.arg("a/row.parquet"));
    for (out, part) in [(&mine, "already exists"), (&row, "lies inside the input corpus")] {
        let outcome = djinn(&["regenerate", "any", "--corpus", &a, "--out", out]);
        refused(&workspace, outcome, &before, &[part, "nothing was changed"]);
    }
}

#[test]
fn of_two_writers_of_one_corpus_one_is_told_and_the_corpus_is_whole() {
    let workspace = Workspace::new();
    write_all(&files(&Path::new(env!("CARGO_MANIFEST_DIR")).join(CORPUS)), &workspace.path("copy"));
    let (out, other) = (workspace.arg("out"), workspace.arg("copy"));
    let commands = [
        vec!["corpus", "merge", CORPUS, &other, "--out", &out],
        vec!["corpus", "filter", CORPUS, "--where", "verified", "--out", &out],
        vec!["export", "openlabel", CORPUS, "--out", &out],
    ];
    for round in 0..4 {
        let spawn = |args: &Vec<&str>| command(args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let children: Vec<_> = commands.iter().map(spawn).collect();
        let outcomes: Vec<_> = children.into_iter().map(|child| child.wait_with_output().unwrap()).collect();
        let codes: Vec<i32> = outcomes.iter().map(|outcome| outcome.status.code().unwrap()).collect();
        assert_eq!(codes.iter().filter(|code| **code == 0).count(), 1, "round {round}: {codes:?}");
        for outcome in outcomes.iter().filter(|outcome| !outcome.status.success()) {
            let said = String::from_utf8_lossy(&outcome.stderr).into_owned();
            assert!(outcome.status.code() == Some(1), "{said}");
            assert!(said.contains("in use by") || said.contains("not empty"), "{said}");
        }
        if codes[2] != 0 {
            djinn(&["corpus", "validate", &out]).expect(0);
        }
        let names: Vec<String> = files(&workspace.path("")).into_keys().collect();
        assert!(names.iter().all(|name| !name.contains(".partial") && !name.contains(".lock")), "{names:?}");
        fs_err::remove_dir_all(&out).unwrap();
    }
}
