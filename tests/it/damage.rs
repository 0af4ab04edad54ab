//! Is damage to what was written an error, and is what was moved still what it was?

use crate::support::{Outcome, Workspace, djinn, files};
use std::path::Path;
use std::process::Command;

const RECORDINGS: &str = "tests/fixtures/recordings/argoverse1";
const CORPUS: &str = "tests/fixtures/corpus/cut_ins";
const MODEL: &str = "pipelines/models/simulated_places.safetensors";

#[test]
fn a_flipped_bit_of_a_model_is_a_fault_and_names_the_model() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    djinn(&["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &out]).expect(0);
    djinn(&["mine", "--output", &out]).expect(0);
    let checkpoint = format!("train.denoiser.checkpoint={MODEL}");
    djinn(&["train", "denoiser", "--set", &checkpoint, "--output", &out]).expect(0);
    let path = workspace.path("out/denoiser/model.safetensors");
    let mut bytes = fs_err::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs_err::write(&path, bytes).unwrap();
    let outcome = djinn(&["train", "classifier", "--output", &out]).expect(2);
    assert!(outcome.stderr.contains("out/denoiser: it is not what stage train_denoiser wrote"), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("--redo train_denoiser"), "{}", outcome.stderr);
}

#[test]
fn a_checkpoint_that_was_moved_is_the_same_and_another_one_is_not() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    let [here, there] = ["here.safetensors", "there.safetensors"].map(|name| workspace.path(name));
    fs_err::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join(MODEL), &here).unwrap();
    let train = |path: &Path, more: &[&str]| {
        let checkpoint = format!("train.denoiser.checkpoint={}", path.display());
        djinn(&[&["train", "denoiser", "--set", &checkpoint, "--output", &out], more].concat()).expect(0)
    };
    train(&here, &[]);
    fs_err::rename(&here, &there).unwrap();
    let plan = train(&there, &["--dry-run"]).stdout;
    assert!(plan.contains("#   train_denoiser    cached"), "{plan}");
    let mut bytes = fs_err::read(&there).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs_err::write(&there, bytes).unwrap();
    let plan = train(&there, &["--dry-run"]).stdout;
    assert!(plan.contains("fresh (changed: ") && plan.contains("input checkpoint)"), "{plan}");
}

/// Runs the program with at most `n_files` open at a time.
#[cfg(unix)]
fn with_few_files(n_files: usize, args: &[&str]) -> Outcome {
    let limited = format!("ulimit -n {n_files} && exec \"$0\" \"$@\"");
    Outcome::of(Command::new("sh").args(["-c", &limited, env!("CARGO_BIN_EXE_djinn")]).args(args))
}

#[cfg(unix)]
#[test]
fn a_system_that_opens_no_more_files_is_not_taken_for_damage() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    djinn(&["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &out]).expect(0);
    let scenes = files(&workspace.path("out/scenes"));
    let mut n_failed = 0;
    for n_files in 5..24 {
        for args in [
            vec!["mine", "--output", &out, "--threads", "1"],
            vec!["mine", "--output", &out, "--threads", "1", "--redo"],
            vec!["corpus", "validate", CORPUS, "--threads", "1"],
        ] {
            let outcome = with_few_files(n_files, &args);
            let said = format!("{n_files} files, {args:?}: {} {}{}", outcome.code, outcome.stdout, outcome.stderr);
            assert!([0, 2].contains(&outcome.code), "{said}");
            assert!(outcome.code == 0 || outcome.stderr.contains("Too many open files"), "{said}");
            for wrong in ["damaged", "damages", "remove", "is missing", "changed"] {
                assert!(outcome.code == 0 || !outcome.stderr.contains(wrong), "{said}");
            }
            n_failed += usize::from(outcome.code != 0);
        }
    }
    assert!(n_failed > 5, "{n_failed}");
    assert_eq!(files(&workspace.path("out/scenes")), scenes);
}

#[test]
fn a_changed_summary_is_not_reported() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    djinn(&["ingest", RECORDINGS, "--dataset", "argoverse1", "--output", &out]).expect(0);
    djinn(&["mine", "--output", &out]).expect(0);
    let path = workspace.path("out/mine.json");
    let text = fs_err::read_to_string(&path).unwrap();
    let changed = text.replacen("\"n_scenes\": 6", "\"n_scenes\": 7", 1);
    assert_ne!(text, changed);
    fs_err::write(&path, changed).unwrap();
    let outcome = djinn(&["report", "--from", &out, "--output", &workspace.arg("page")]).expect(2);
    assert!(outcome.stderr.contains("out/mine.json: it is not what stage mine wrote there"), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("--redo mine"), "{}", outcome.stderr);
}

#[test]
fn what_was_made_of_recordings_stays_without_them() {
    let workspace = Workspace::new();
    let (out, here) = (workspace.arg("out"), workspace.path("here/train/data"));
    fs_err::create_dir_all(&here).unwrap();
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join(RECORDINGS).join("train/data/1.csv");
    fs_err::copy(recording, here.join("1.csv")).unwrap();
    let from = workspace.arg("here");
    let ingest = |more: &[&str]| {
        let args = ["ingest", &from, "--dataset", "argoverse1", "--set", "ingest.maps=none", "--output", &out];
        djinn(&[&args, more].concat())
    };
    ingest(&[]).expect(0);
    fs_err::remove_dir_all(workspace.path("here")).unwrap();
    let plan = ingest(&["--dry-run"]).expect(0).stdout;
    assert!(plan.contains("#   ingest            cached"), "{plan}");
    djinn(&["mine", "--output", &out]).expect(0);
    // A stage that must be run anew needs them.
    let told = ingest(&["--set", "ingest.max_agents=3"]).expect(1).stderr;
    assert!(told.contains("failed to read the input inputs.0"), "{told}");
}

#[test]
fn recordings_that_were_moved_are_not_ingested_again_and_changed_ones_are() {
    let workspace = Workspace::new();
    let out = workspace.arg("out");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (name, bytes) in files(&root.join(RECORDINGS)) {
        for folder in ["here", "there"] {
            let path = workspace.path(folder).join(&name);
            fs_err::create_dir_all(path.parent().unwrap()).unwrap();
            fs_err::write(path, &bytes).unwrap();
        }
    }
    let ingest = |from: &str, more: &[&str]| {
        let args = [&["ingest", from, "--dataset", "argoverse1", "--output", &out], more].concat();
        djinn(&args).expect(0)
    };
    ingest(&workspace.arg("here"), &[]);
    let written = files(&workspace.path("out/scenes"));
    for moved in [workspace.arg("there"), format!("{}/./", workspace.arg("here"))] {
        let plan = ingest(&moved, &["--dry-run"]).stdout;
        assert!(plan.contains("#   ingest            cached"), "{plan}");
    }
    assert!(!ingest(&workspace.arg("there"), &[]).stderr.contains("runs again"));
    assert_eq!(files(&workspace.path("out/scenes")), written);
    // Their results stay without them, wherever they were last.
    fs_err::rename(workspace.path("there"), workspace.path("away")).unwrap();
    assert!(ingest(&workspace.arg("there"), &["--dry-run"]).stdout.contains("#   ingest            cached"));
    fs_err::rename(workspace.path("away"), workspace.path("there")).unwrap();
    fs_err::write(workspace.path("there/more.txt"), "new").unwrap();
    let told = ingest(&workspace.arg("there"), &["--dry-run"]).stdout;
    assert!(told.contains("input inputs.0"), "{told}");
}
