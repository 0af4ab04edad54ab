//! What do people and scripts see of the program: help, exit codes, streams?

use crate::skipped::skipped;
use crate::support::{Outcome, Workspace, command, djinn, root};
use std::ffi::OsStr;
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::Stdio;

#[test]
fn help_teaches_every_command() {
    let top = djinn(&["--help"]).expect(0).stdout;
    for part in ["Examples:", "Exit codes:", "a quality gate failed", "quickstart.toml"] {
        assert!(top.contains(part), "`{part}` is missing in\n{top}");
    }
    let corpus_tools = ["validate", "merge", "filter"].map(|tool| format!("corpus {tool}"));
    let stages = [
        "run",
        "ingest",
        "mine",
        "train denoiser",
        "train distill",
        "train classifier",
        "train baseline",
        "generate",
        "evaluate",
        "report",
        "export",
        "inspect",
        "submit",
        "status",
        "init",
        "list",
        "completions",
    ];
    for command in stages.into_iter().chain(corpus_tools.iter().map(String::as_str)) {
        let first_word = command.split(' ').next().unwrap();
        assert!(top.contains(&format!("\n  {first_word}")), "{first_word}");
        let args: Vec<&str> = command.split(' ').chain(["--help"]).collect();
        let help = djinn(&args).expect(0).stdout;
        assert!(help.contains("Example"), "{command} has no example");
    }
    // A program names itself as its results do: by the source it was built from, or else by its own content.
    let version = djinn(&["--version"]).expect(0).stdout;
    let (begin, end) = version.trim_end().split_once(" (").unwrap();
    assert_eq!(begin, format!("djinn {}", env!("CARGO_PKG_VERSION")));
    assert!(end.ends_with(')') && end.len() > "build )".len(), "{version}");
}

#[test]
fn exit_codes_tell_whose_fault_it_is() {
    djinn(&["frobnicate"]).expect(1);
    djinn(&["run"]).expect(1);
    djinn(&["run", "missing.toml"]).expect(1);
    djinn(&["inspect", "Cargo.toml"]).expect(1);
    djinn(&["mine", "--quiet", "--verbose", "--output", "x"]).expect(1);

    // A file without an end, or with another content the next time, is no input.
    let workspace = Workspace::new();
    let output = workspace.arg("devices");
    for args in [
        vec!["inspect", "/dev/zero"],
        vec!["run", "/dev/zero"],
        vec!["mine", "--config", "/dev/zero", "--output", &output],
        vec!["ingest", "/dev/zero", "--dataset", "argoverse1", "--output", &output],
    ] {
        let outcome = djinn(&args).expect(1);
        assert!(outcome.stderr.contains("/dev/zero is neither a file nor a folder"), "{}", outcome.stderr);
    }

    let outcome = djinn(&["report", "--from", "src", "--output", &workspace.arg("page")]).expect(1);
    assert!(outcome.stderr.contains("src has no results of a run to report on"), "{}", outcome.stderr);
    for output in ["Cargo.toml", "Cargo.toml/below", "/dev/null"] {
        let outcome = djinn(&["report", "--from", "output", "--output", output]).expect(1);
        assert!(outcome.stderr.contains("is not a folder"), "{}", outcome.stderr);
    }

    // A damaged file of ours is a fault of ours or of the machine.
    let output = workspace.arg("out");
    let recordings = "tests/fixtures/recordings/argoverse1";
    djinn(&["ingest", recordings, "--dataset", "argoverse1", "--output", &output]).expect(0);
    fs_err::write(workspace.path("out/scenes/scenes-00000.arrow"), "damaged").unwrap();
    let outcome = djinn(&["inspect", &workspace.arg("out/scenes")]).expect(2);
    assert!(outcome.stderr.contains("scenes-00000.arrow"), "{}", outcome.stderr);
}

#[test]
fn recordings_are_explained_without_a_run() {
    let workspace = Workspace::new();
    let recordings = "tests/fixtures/recordings/interaction_v1_1";
    let (output, picture) = (workspace.arg("out"), workspace.arg("scene.svg"));
    let args = ["ingest", recordings, "--dataset", "interaction", "--output", &output, "--set", "ingest.limit=3"];
    let outcome = djinn(&[&args[..], &[&format!("--explain={picture}")]].concat()).expect(0);
    for expected in
        ["3, of ", "FIX_Intersection", "40 timesteps of 0.1 s", "% of moving vehicles are within 2 m", "\nvehicle "]
    {
        assert!(outcome.stdout.contains(expected), "{expected}: {}", outcome.stdout);
    }
    assert!(fs_err::read_to_string(&picture).unwrap().starts_with("<svg"));
    assert!(!workspace.path("out").exists(), "nothing else is written");
    // The folder of a run need not be named.
    djinn(&["ingest", recordings, "--dataset", "interaction", "--explain"]).expect(0);
}

/// A disk is full when nothing more can be written. Here no file may become longer than a few hundred bytes, which
/// fails in the same places.
#[cfg(unix)]
#[test]
fn a_full_disk_is_a_fault_of_the_machine_and_leaves_no_half_result() {
    let workspace = Workspace::new();
    let [a, out] = ["a", "out"].map(|name| workspace.arg(name));
    let recordings = "tests/fixtures/recordings/argoverse1";
    djinn(&["ingest", recordings, "--dataset", "argoverse1", "--set", "ingest.limit=2", "--output", &a]).expect(0);
    let corpus = "tests/fixtures/corpus/cut_ins";
    for args in [
        vec!["report", "--from", &a, "--output", &out],
        vec!["mine", "--output", &a],
        vec!["corpus", "filter", corpus, "--where", "verified", "--out", &out],
        vec!["export", "openlabel", corpus, "--out", &out],
    ] {
        let whole = command(&args);
        let mut limited = std::process::Command::new("sh");
        limited.args(["-c", "trap '' XFSZ; ulimit -f 1; exec \"$0\" \"$@\""]).arg(whole.get_program());
        let said = Outcome::of(limited.args(whole.get_args()).current_dir(root())).expect(2).stderr;
        assert!(said.contains("File too large"), "{args:?}: {said}");
        assert!(!workspace.path("out/report.html").exists() && !workspace.path("a/events.parquet").exists());
        assert!(workspace.path("out").is_dir() == (args[1] == "--from"), "{args:?}");
        fs_err::remove_dir_all(&out).ok();
    }
    // Where a path leads is the user's affair.
    let outcome = djinn(&["corpus", "filter", corpus, "--where", "verified", "--out", "Cargo.toml/out"]).expect(1);
    assert!(outcome.stderr.contains("Cargo.toml"), "{}", outcome.stderr);
}

#[test]
fn data_goes_to_stdout_and_everything_else_to_stderr() {
    let workspace = Workspace::new();
    let output = workspace.arg("out");
    let args = ["ingest", "tests/fixtures/recordings/argoverse1", "--dataset", "argoverse1", "--output", &output];
    let outcome = djinn(&args).expect(0);
    assert_eq!(outcome.stdout, "");
    assert!(outcome.stderr.contains("ingest: 8 scenes in "), "{}", outcome.stderr);
    assert!(!outcome.stderr.contains('\u{1b}'), "no colors without a terminal");
    let text = djinn(&["inspect", &workspace.arg("out/scenes")]).expect(0);
    assert!(text.stdout.contains("n scenes: 8") && text.stderr.is_empty(), "{}", text.stdout);
}

#[test]
fn names_of_files_do_not_speak_to_the_terminal() {
    let workspace = Workspace::new();
    let name = workspace.arg("red\u{1b}[31m\r");
    let archive = fs_err::File::create(workspace.path("hostile.zip")).unwrap();
    let mut archive = zip::ZipWriter::new(archive);
    archive.start_file("X/vehicle_tracks_000\u{1b}[31m.csv", zip::write::SimpleFileOptions::default()).unwrap();
    archive.finish().unwrap();
    let (zip, out) = (workspace.arg("hostile.zip"), workspace.arg("out"));
    for args in [
        vec!["inspect", &name],
        vec!["run", &name],
        vec!["ingest", &name, "--dataset", "interaction", "--output", &out],
        vec!["ingest", &zip, "--dataset", "interaction", "--set", "ingest.maps=none", "--output", &out],
    ] {
        let said = djinn(&args).expect(1).stderr;
        assert!(said.chars().all(|c| c == '\n' || !c.is_control()), "{said:?}");
        assert!(said.contains("[31m"), "{said}");
    }
}

#[test]
fn recordings_are_read_wherever_they_lie() {
    let workspace = Workspace::new();
    let output = workspace.arg("out");
    // Both are the same text once what is no UTF-8 is replaced.
    let folders = [b"Stra\xdfe", b"Stra\xe4e"].map(|name| workspace.path("").join(OsStr::from_bytes(name)));
    for (i, folder) in folders.iter().enumerate() {
        if let Err(error) = fs_err::create_dir_all(folder) {
            return skipped("a file system whose names need not be UTF-8", &error.to_string());
        }
        let recording = format!("tests/fixtures/recordings/argoverse1/train/data/{}.csv", i + 1);
        fs_err::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join(recording), folder.join(format!("{i}.csv"))).unwrap();
    }
    let args = ["ingest", "--dataset", "argoverse1", "--set", "ingest.maps=none", "--output", &output];
    // The second time, they are known.
    for said in ["ingest: 2 scenes", "everything is up to date"] {
        let stderr = Outcome::of(command(&args).args(&folders)).expect(0).stderr;
        assert!(stderr.contains(said), "{stderr}");
    }
}

#[test]
fn a_reader_that_has_seen_enough_is_no_error() {
    let mut child = command(&["run", "pipelines/quickstart.toml", "--dry-run"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let mut stderr = String::new();
    child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
    assert_eq!((child.wait().unwrap().code(), stderr.as_str()), (Some(0), ""));
}

#[test]
fn two_processes_do_not_write_into_one_folder() {
    let workspace = Workspace::new();
    fs_err::create_dir_all(workspace.run_folder("out")).unwrap();
    let lock = fs_err::File::create(workspace.run_folder("out").join(".lock")).unwrap();
    lock.try_lock().unwrap();
    let outcome = workspace.run("out", &[]).expect(1);
    assert!(outcome.stderr.contains("is in use by"), "{}", outcome.stderr);
}

#[test]
fn urls_of_object_stores_are_refused_where_they_cannot_be() {
    let workspace = Workspace::new();
    let pipeline = workspace.path("small.toml");
    let pipeline = pipeline.to_str().unwrap();
    for args in [
        &["corpus", "filter", "x", "--where", "verified", "--out", "s3://bucket/out"][..],
        &["export", "commonroad", "x", "--out", "gs://bucket/out"],
        &["generate", "--denoiser", "s3://bucket/model", "--output", "x"],
        &["status", "x", "--cache-dir", "s3://bucket/cache"],
        &["status", "gs://bucket/runs/small/main"],
        &["corpus", "validate", "s3://bucket/corpus"],
        &["inspect", "s3://bucket/corpus"],
        &["mine", "--output", "s3://bucket/run"],
    ] {
        let said = djinn(args).expect(1).stderr;
        assert!(said.contains("expected a path on disk, not a URL of an object store"), "{said}");
    }
    for args in [
        &["submit", pipeline, "--engine", "slurm", "--output", "s3://bucket/runs"][..],
        &["run", pipeline, "--stage", "generate", "--part", "plan", "--output", "s3://bucket/runs"],
    ] {
        let said = djinn(args).expect(1).stderr;
        assert!(said.contains("s3://bucket/runs/small/main: workers need a folder that all of them see"), "{said}");
    }
    let inputs = "ingest.inputs=['s3://bucket/runs']";
    let said = djinn(&["run", pipeline, "--output", "s3://bucket/runs", "--set", inputs]).expect(1).stderr;
    assert!(said.contains("inside the input") || said.contains("built without object stores"), "{said}");
    let said = djinn(&["run", pipeline, "--output", "s3://me:hunter2@bucket/runs"]).expect(1).stderr;
    assert!(said.contains("no credentials; they come from the environment") && !said.contains("hunter2"), "{said}");
    assert!(!std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("s3:").exists());
}

#[cfg(not(feature = "cloud"))]
#[test]
fn a_build_without_object_stores_says_which_has_them() {
    let workspace = Workspace::new();
    let pipeline = workspace.path("small.toml");
    let said = djinn(&["run", pipeline.to_str().unwrap(), "--output", "s3://bucket/runs"]).expect(1).stderr;
    assert!(said.contains("built without object stores") && said.contains("--features cloud"), "{said}");
}
