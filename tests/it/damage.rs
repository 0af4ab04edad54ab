//! Is damage to what was written an error, and is what was moved still what it was?

use crate::support::{Workspace, djinn, files};
use std::path::Path;

const RECORDINGS: &str = "tests/fixtures/recordings/argoverse1";
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
    fs_err::write(workspace.path("there/more.txt"), "new").unwrap();
    let told = ingest(&workspace.arg("there"), &["--dry-run"]).stdout;
    assert!(told.contains("input inputs.0"), "{told}");
}
