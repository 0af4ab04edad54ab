//! Do several processes train the model that one trains, whoever of them is killed or stopped? And whom do they refuse?

use crate::support::{Outcome, Workspace, assert_same, command, files};
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A training of four parts, whose state is saved at its end alone unless something happens.
const SETTINGS: [&str; 14] = [
    "--threads",
    "1",
    "--set",
    "train.denoiser.batch_size=4",
    "--set",
    "train.denoiser.parts=4",
    "--set",
    "train.denoiser.steps=60",
    "--set",
    "train.denoiser.save_every=1000",
    "--set",
    "train.classifier.parts=2",
    "--set",
    "cluster.ranks_wait_s=60",
];

fn run(workspace: &Workspace, output: &str, more: &[&str]) -> Outcome {
    workspace.run(output, &[&SETTINGS[..], more].concat())
}

/// Where ranks meet: a port that nobody listens at.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Starts one of the ranks of a training.
fn begin(workspace: &Workspace, output: &str, (rank, n_ranks): (usize, usize), port: u16, more: &[&str]) -> Child {
    let args = workspace.run_args(output, &[&SETTINGS[..], more].concat());
    let mut command = command(&args.iter().map(String::as_str).collect::<Vec<_>>());
    let variables =
        [("RANK", rank.to_string()), ("WORLD_SIZE", n_ranks.to_string()), ("MASTER_PORT", port.to_string())];
    command
        .envs(variables)
        .env("MASTER_ADDR", "127.0.0.1")
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Starts all ranks of a training stage.
fn begin_all(workspace: &Workspace, output: &str, stage: &str, n_ranks: usize) -> Vec<Child> {
    let port = free_port();
    (0..n_ranks).map(|rank| begin(workspace, output, (rank, n_ranks), port, &["--stage", stage])).collect()
}

/// The exit code and what was said.
fn ended(child: Child) -> (Option<i32>, String) {
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[track_caller]
fn expect_all(ranks: Vec<Child>, code: i32, words: &str) {
    for (rank, child) in ranks.into_iter().enumerate() {
        let (found, said) = ended(child);
        assert!(found == Some(code) && said.contains(words), "rank {rank} ended with {found:?}: {said}");
    }
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < Duration::from_secs(120), "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn n_lines(path: &Path) -> usize {
    fs_err::read_to_string(path).map_or(0, |text| text.lines().count())
}

#[test]
fn ranks_that_are_killed_and_stopped_train_the_model_of_one_process() {
    let workspace = Workspace::new();
    for output in ["whole", "ranks"] {
        run(&workspace, output, &["--stage", "ingest", "--stage", "mine"]).expect(0);
    }
    for stage in ["train_denoiser", "train_classifier"] {
        run(&workspace, "whole", &["--stage", stage]).expect(0);
    }
    let folder = workspace.run_folder("ranks");
    let training = folder.join("train_denoiser.partial/denoiser");
    let (statistics, state) = (training.join("statistics.jsonl"), training.join("state.safetensors"));

    // One of four is killed: the others keep what is done.
    let mut ranks = begin_all(&workspace, "ranks", "train_denoiser", 4);
    wait_until("the training is under way", || n_lines(&statistics) > 0);
    assert!(!state.exists());
    let mut killed = ranks.remove(2);
    killed.kill().unwrap();
    killed.wait().unwrap();
    expect_all(ranks, 75, "run the same command again to continue");
    assert!(state.exists());

    // One of two is told to stop: both stop, and neither before the other.
    let ranks = begin_all(&workspace, "ranks", "train_denoiser", 2);
    let n_before = n_lines(&statistics);
    wait_until("the training goes on", || n_lines(&statistics) > n_before);
    assert!(Command::new("kill").arg(ranks[1].id().to_string()).status().unwrap().success());
    expect_all(ranks, 75, "stopped after step");

    // A stranger at the door of rank 0 does no harm.
    let port = free_port();
    let first = begin(&workspace, "ranks", (0, 4), port, &["--stage", "train_denoiser"]);
    wait_until("rank 0 listens", || {
        TcpStream::connect(("127.0.0.1", port)).and_then(|mut door| door.write_all(&[7; 50_000])).is_ok()
    });
    let others = (1..4).map(|rank| begin(&workspace, "ranks", (rank, 4), port, &["--stage", "train_denoiser"]));
    let ranks = std::iter::once(first).chain(others.collect::<Vec<_>>()).collect();
    expect_all(ranks, 0, "");
    expect_all(begin_all(&workspace, "ranks", "train_classifier", 2), 0, "");
    assert_same(&files(&workspace.run_folder("whole")), &files(&folder));
    // What is done needs nobody to wait for.
    expect_all(vec![begin(&workspace, "ranks", (1, 2), port, &["--stage", "train_classifier"])], 0, "");
    expect_all(vec![begin(&workspace, "ranks", (0, 2), port, &["--stage", "train_classifier"])], 0, "");
}

#[test]
fn ranks_that_do_not_fit_are_refused_before_anything_is_trained() {
    let workspace = Workspace::new();
    run(&workspace, "out", &["--stage", "ingest"]).expect(0);
    let before = files(&workspace.run_folder("out"));
    let begin = |place: (usize, usize), port: u16, more: &[&str]| {
        begin(&workspace, "out", place, port, &[&["--stage", "train_denoiser"], more].concat())
    };
    let expect = |child: Child, code: i32, words: &[&str]| {
        let (found, said) = ended(child);
        assert!(found == Some(code) && words.iter().all(|word| said.contains(word)), "{found:?}: {said}");
    };
    let impatient = ["--set", "cluster.ranks_wait_s=6"];
    // Another plan: the one is told, the other waits for the right one in vain.
    let port = free_port();
    let first = begin((0, 2), port, &impatient);
    let other_plan = [&impatient[..], &["--set", "train.denoiser.learning_rate=0.004"]].concat();
    let why = "changed: train.denoiser.learning_rate";
    expect(begin((1, 2), port, &other_plan), 1, &["rank 0 refused this process", why]);
    expect(first, 1, &["1 of 2 ranks did not come within 6 s: 1; refused: rank 1", why]);
    // Nobody comes, or nobody is there: that may change.
    let impatient = ["--set", "cluster.ranks_wait_s=1"];
    expect(begin((0, 2), port, &impatient), 75, &["1 of 2 ranks did not come within 1 s: 1"]);
    expect(begin((1, 2), port, &impatient), 75, &["rank 0 does not answer at 127.0.0.1"]);
    // Numbers of processes that the parts cannot be shared among, and places that make no sense.
    expect(begin((0, 8), port, &[]), 1, &["train.denoiser.parts is 4: 8 ranks cannot share 4 parts"]);
    expect(begin((1, 2), port, &["--set", "train.denoiser.parts=1"]), 1, &["train.denoiser.parts is 1"]);
    expect(begin((2, 2), port, &[]), 1, &["RANK is 2 in the environment, expected 0 to 1"]);
    expect(begin((0, 2), port, &["--stage", "train_classifier"]), 1, &["can train one stage together"]);
    assert_same(&before, &files(&workspace.run_folder("out")));
}
