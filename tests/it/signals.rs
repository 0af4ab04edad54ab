//! What does a signal leave, and what is printed about it?

use crate::support::{Workspace, assert_same, djinn, files, wait_for_part};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const CORPUS: &str = "tests/fixtures/corpus/cut_ins";

/// Starts the program as `env` leaves its signals: whoever runs the tests may have some ignored.
fn start(signals: &str, args: &[&str]) -> Child {
    let mut command = Command::new("env");
    command.args([signals, env!("CARGO_BIN_EXE_djinn")]).args(args).current_dir(env!("CARGO_MANIFEST_DIR"));
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

fn send(child: &Child, signal: &str) {
    assert!(Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap().success());
}

/// The exit code, or 128 and the number of the signal that ended the program, as a shell reports it; and the output.
fn ended(child: Child) -> (i32, String) {
    let output = child.wait_with_output().unwrap();
    let code = output.status.code().or(output.status.signal().map(|signal| 128 + signal));
    (code.unwrap(), String::from_utf8(output.stderr).unwrap())
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < Duration::from_secs(120), "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_run_says_what_stays_and_how_it_goes_on() {
    let workspace = Workspace::new();
    for (signal, code) in [("TERM", 75), ("USR1", 75), ("INT", 130), ("HUP", 129)] {
        let args = workspace.run_args(signal, &[]);
        let child = start("--default-signal", &args.iter().map(String::as_str).collect::<Vec<_>>());
        let folder = workspace.run_folder(signal);
        wait_until("a stage begins", || folder.join("ingest.partial").exists());
        send(&child, signal);
        let (ended_by, said) = ended(child);
        assert_eq!(ended_by, code, "{said}");
        // A run that is between two stages stops by itself.
        assert!(said.contains(&format!("ended by SIG{signal}: ")) || said.contains("stopped before stage"), "{said}");
        let kept = format!("finished shards and saved training states are kept in {}", folder.display());
        assert!(said.contains(&kept) && said.contains("run the same command again to continue"), "{said}");
    }
}

#[test]
fn an_ignored_signal_stays_ignored() {
    let workspace = Workspace::new();
    let args = workspace.run_args("out", &[]);
    let mut child = start("--ignore-signal=HUP", &args.iter().map(String::as_str).collect::<Vec<_>>());
    let folder = workspace.run_folder("out");
    wait_until("a stage begins", || folder.join("ingest.partial").exists());
    send(&child, "HUP");
    std::thread::sleep(Duration::from_millis(200));
    assert!(child.try_wait().unwrap().is_none());
    send(&child, "TERM");
    assert_eq!(ended(child).0, 75);
}

/// The state of a training is saved at its end alone, but for signals.
const RARELY_SAVED: [&str; 6] = [
    "--set",
    "train.denoiser.save_every=1000",
    "--set",
    "train.classifier.evaluate_every=2000",
    "--set",
    "train.denoiser.steps=60",
];

#[test]
fn what_was_stopped_in_training_and_in_generation_goes_on_to_the_same_bytes() {
    let workspace = Workspace::new();
    workspace.run("whole", &RARELY_SAVED).expect(0);
    let args = workspace.run_args("stopped", &RARELY_SAVED);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let folder = workspace.run_folder("stopped");
    let training = folder.join("train_denoiser.partial/denoiser");
    let sign = training.join("statistics.jsonl");
    let begun: [(_, &dyn Fn(), _); 2] = [
        ("TERM", &|| wait_until("statistics appear", || sign.exists()), Some(training.join("state.safetensors"))),
        ("USR1", &|| wait_for_part(&folder, "generate", "samples-00001.json"), None),
    ];
    for (signal, wait, kept) in begun {
        let child = start("--default-signal", &args);
        wait();
        let (told, is_kept) = (Instant::now(), kept.as_ref().is_none_or(|kept| !kept.exists()));
        send(&child, signal);
        let (code, said) = ended(child);
        assert_eq!(code, 75, "{said}");
        assert!(told.elapsed() < Duration::from_secs(20), "{:?}", told.elapsed());
        assert!(said.contains("was stopped") && said.contains("run the same command again to continue"), "{said}");
        assert!(is_kept && kept.is_none_or(|kept| kept.exists()), "the state is saved, and by the signal alone");
    }
    let log = fs_err::read_to_string(folder.join("log.txt")).unwrap();
    assert!(log.contains("stopped: stage train_denoiser was stopped: stopped after step"), "{log}");
    workspace.run("stopped", &RARELY_SAVED).expect(0);
    assert_same(&files(&workspace.run_folder("whole")), &files(&folder));
}

#[test]
fn a_tool_says_that_nothing_came_to_be() {
    let workspace = Workspace::new();
    let (out, lock) = (workspace.arg("new"), workspace.path(".new.lock"));
    // It waits for the lock a moment.
    let held = fs_err::File::create(&lock).unwrap();
    held.try_lock().unwrap();
    let filter = ["corpus", "filter", CORPUS, "--where", "verified", "--out", &out];
    let child = start("--default-signal", &filter);
    let open_files = format!("/proc/{}/fd", child.id());
    let is_open = |path: &Path| fs_err::read_link(path).is_ok_and(|target| target == lock);
    wait_until("the lock is wanted", || {
        fs_err::read_dir(&open_files).unwrap().any(|entry| is_open(&entry.unwrap().path()))
    });
    send(&child, "TERM");
    let (ended_by, said) = ended(child);
    assert_eq!(ended_by, 143, "{said}");
    assert!(said.contains(&format!("ended by SIGTERM: {out} is unchanged")), "{said}");
    assert!(!workspace.path("new").exists());
    drop(held);
    djinn(&filter).expect(0);
}
