//! Does the program alone suffice to start: a folder with all that a pipeline reads, lists of names, completions?

use crate::support::{Workspace, command, djinn, files};
use std::path::Path;

/// `djinn run PIPELINE --dry-run` in `folder`, with further options.
fn dry_run(folder: &Path, pipeline: &str, more: &[&str]) -> (Option<i32>, String) {
    let args = [&["run", pipeline, "--dry-run"], more].concat();
    let output = command(&args).current_dir(folder).output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

#[test]
fn the_quickstart_runs_in_a_folder_of_its_own() {
    let workspace = Workspace::new();
    let told = djinn(&["init", &workspace.arg("first")]).expect(0);
    assert!(told.stdout.is_empty() && told.stderr.contains("djinn run quickstart.toml"), "{}", told.stderr);
    let names: Vec<String> = files(&workspace.path("first")).into_keys().collect();
    let expected = [
        "models/geometric.safetensors",
        "models/geometric_two_steps.safetensors",
        "quickstart.toml",
        "recordings/FIX-multi-v1_2.zip",
    ];
    assert_eq!(names, expected);
    let (code, printed) = dry_run(&workspace.path("first"), "quickstart.toml", &[]);
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("inputs = [\"recordings/FIX-multi-v1_2.zip\"]"), "{printed}");

    // A stage would complain about a missing recording or model.
    fs_err::remove_file(workspace.path("first/models/geometric.safetensors")).unwrap();
    let (code, printed) = dry_run(&workspace.path("first"), "quickstart.toml", &[]);
    assert!(code == Some(1) && printed.contains("models/geometric.safetensors"), "{printed}");
}

#[test]
fn a_bundled_pipeline_runs_by_its_name_in_any_folder() {
    let workspace = Workspace::new();
    let folder = workspace.path("anywhere");
    fs_err::create_dir(&folder).unwrap();
    for has_written in [true, false] {
        let (code, printed) = dry_run(&folder, "quickstart", &[]);
        assert_eq!(code, Some(0), "{printed}");
        assert_eq!(printed.contains("wrote quickstart/quickstart.toml"), has_written, "{printed}");
        assert!(printed.contains("inputs = [\"quickstart/recordings/FIX-multi-v1_2.zip\"]"), "{printed}");
    }
    let (code, printed) = dry_run(&folder, "quickstop", &[]);
    assert!(code == Some(1) && printed.contains("quickstop"), "{printed}");
    // Colors, if they are asked for.
    for (color, is_colored) in [("always", true), ("never", false), ("auto", false)] {
        let (_, printed) = dry_run(&folder, "quickstop", &["--color", color]);
        assert_eq!(printed.contains("\u{1b}["), is_colored, "{printed}");
    }
}

#[test]
fn other_pipelines_come_with_the_models_that_they_name() {
    let workspace = Workspace::new();
    djinn(&["init", &workspace.arg("request"), "cut_in_request", "--quiet"]).expect(0);
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/recordings/interaction_v1_1");
    let inputs = format!("ingest.inputs=[\"{}\"]", recordings.display());
    let (code, printed) = dry_run(&workspace.path("request"), "cut_in_request.toml", &["--set", &inputs]);
    assert_eq!(code, Some(0), "{printed}");

    let unknown = djinn(&["init", &workspace.arg("other"), "cut_out_request"]).expect(1);
    assert!(unknown.stderr.contains("cut_in_request") && !workspace.path("other").exists(), "{}", unknown.stderr);
}

#[cfg(unix)]
#[test]
fn a_current_folder_that_is_gone_is_told_as_that() {
    let workspace = Workspace::new();
    let script = "mkdir \"$1\" && cd \"$1\" && rmdir \"$1\" && exec \"$2\" init first";
    let gone = workspace.arg("gone");
    let args = ["-c", script, "sh", &gone, env!("CARGO_BIN_EXE_djinn")];
    let output = std::process::Command::new("sh").args(args).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(told.contains("the folder that first is relative to is gone"), "{told}");
}

#[test]
fn a_folder_that_holds_anything_stays_as_it_is() {
    let workspace = Workspace::new();
    let before = files(&workspace.path(""));
    let refused = djinn(&["init", &workspace.arg("")]).expect(1);
    assert!(refused.stderr.contains("is not empty; choose a new folder"), "{}", refused.stderr);
    let refused = djinn(&["init", &workspace.arg("small.toml")]).expect(1);
    assert!(refused.stderr.contains("small.toml is a file; choose a new folder"), "{}", refused.stderr);
    assert_eq!(files(&workspace.path("")), before);
    let told = djinn(&["init", &workspace.arg("my first")]).expect(0).stderr;
    assert!(told.contains(&format!("next: cd '{}' && djinn run", workspace.arg("my first"))), "{told}");
    fs_err::create_dir(workspace.path("here")).unwrap();
    let output = command(&["init", "."]).current_dir(workspace.path("here")).output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("next: djinn run quickstart.toml"), "{told}");
    assert!(workspace.path("here/quickstart.toml").is_file());
    fs_err::create_dir(workspace.path("empty")).unwrap();
    djinn(&["init", &workspace.arg("empty"), "scene_transformer"]).expect(0);
    assert!(workspace.path("empty/scene_transformer.toml").is_file());
}

#[test]
fn lists_name_everything_with_a_line() {
    for (what, n_least, name, line) in [
        ("behaviors", 14, "left_turn", "an agent turns left by at least 60 degrees, as at an intersection"),
        ("objectives", 8, "slip_limit", "Keep the heading along the motion"),
        ("datasets", 6, "commonroad", "Scenarios in CommonRoad's XML, recorded or generated"),
        (
            "formats",
            5,
            "openlabel",
            "OpenLABEL 1.0 JSON: tags for behaviors, roles, parameters and provenance; no states",
        ),
        ("metrics", 40, "collision_rate", "share of samples in which any two agents collide"),
    ] {
        let text = djinn(&["list", what]).expect(0).stdout;
        let rows: Vec<(&str, &str)> = text.lines().map(|line| line.split_once("  ").unwrap()).collect();
        assert!(rows.len() >= n_least && rows.iter().all(|(_, text)| !text.trim().is_empty()), "{text}");
        assert!(rows.iter().any(|row| row.0 == name && row.1.trim() == line), "{text}");
    }
    let behaviors = djinn(&["list", "behaviors"]).expect(0).stdout;
    let of_tailgating = behaviors.lines().skip_while(|line| !line.starts_with("tailgating")).nth(1).unwrap();
    for part in ["time_headway_s", "; templates aim at time_headway_s, mean_speed_mps"] {
        assert!(of_tailgating.contains(part), "{of_tailgating}");
    }
    let refused = djinn(&["list", "stages"]).expect(1);
    assert!(refused.stderr.contains("behaviors"), "{}", refused.stderr);
}

#[test]
fn shells_complete_commands_and_pipelines() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = djinn(&["completions", shell]).expect(0).stdout;
        for word in ["regenerate", "no-progress", "objectives"] {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
    // The shell itself has to understand it.
    let script = djinn(&["completions", "bash"]).expect(0).stdout;
    let question = "COMP_WORDS=(djinn init here coll); COMP_CWORD=3; _djinn djinn coll here; echo \"${COMPREPLY[@]}\"";
    let answer = std::process::Command::new("bash").args(["-c", &format!("{script}\n{question}")]).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&answer.stdout).trim(), "collision_request");
}

#[test]
fn every_command_has_a_manual_page() {
    let workspace = Workspace::new();
    djinn(&["man", &workspace.arg("pages")]).expect(0);
    let pages = files(&workspace.path("pages"));
    for (page, says) in
        [("djinn.1", "djinn\\-run(1)"), ("djinn-run.1", "PIPELINE"), ("djinn-corpus-filter.1", "filter")]
    {
        assert!(String::from_utf8_lossy(&pages[page]).contains(says), "{page}");
    }
}
