//! What does a signal leave, and what is said of it?

use crate::support::{Workspace, djinn};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const CORPUS: &str = "tests/fixtures/corpus/corpus.v2_scenario.v4";

/// Starts the program as `env` leaves its signals: whoever runs the tests may have some ignored.
fn start(signals: &str, args: &[&str]) -> Child {
    let mut command = Command::new("env");
    command.args([signals, env!("CARGO_BIN_EXE_djinn")]).args(args).current_dir(env!("CARGO_MANIFEST_DIR"));
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

fn send(child: &Child, signal: &str) {
    assert!(Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap().success());
}

/// The signal that ended the program, and what was said.
fn ended(child: Child) -> (Option<i32>, String) {
    let output = child.wait_with_output().unwrap();
    (output.status.signal(), String::from_utf8(output.stderr).unwrap())
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < Duration::from_secs(120), "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_run_says_what_stays_and_ends_by_the_signal() {
    let workspace = Workspace::new();
    for (signal, number) in [("TERM", 15), ("INT", 2), ("HUP", 1)] {
        let args = workspace.run_args(signal, &[]);
        let child = start("--default-signal", &args.iter().map(String::as_str).collect::<Vec<_>>());
        let folder = workspace.run_folder(signal);
        wait_until("a stage begins", || folder.join("ingest.partial").exists());
        send(&child, signal);
        let (ended_by, said) = ended(child);
        assert_eq!(ended_by, Some(number), "{said}");
        let expected =
            format!("ended by SIG{signal}: finished shards and saved training states are kept in {}", folder.display());
        assert!(said.contains(&expected) && said.contains("run the same command again to continue"), "{said}");
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
    assert_eq!(ended(child).0, Some(15));
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
    assert_eq!(ended_by, Some(15), "{said}");
    assert!(said.contains(&format!("ended by SIGTERM: {out} is unchanged")), "{said}");
    assert!(!workspace.path("new").exists());
    drop(held);
    djinn(&filter).expect(0);
}
