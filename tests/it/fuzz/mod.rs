//! Do readers of files that others wrote, or that are damaged, always end in a result or an error?
//!
//! Each target is a reader with files to start from. They are damaged at random (`mutate`) and read, thousands of
//! times, in a process of its own: it must not panic, must not take longer than [`MAX_SECONDS`] for an input, nor hold
//! more than [`MAX_BYTES`] at any time. What breaks a target is kept in a file that the failure names.
//!
//! The ordinary tests give each target a moment. `DJINN_FUZZ_SECONDS=300 cargo test --test it fuzz::` gives it five
//! minutes, and `DJINN_FUZZ_SEED` another course. The harness is our own because those that guide their inputs by
//! coverage want compilers of their own.

mod mutate;
mod targets;

use mutate::damaged;
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::time::{Duration, Instant};
use targets::{TARGETS, Target};

/// Seconds of an ordinary test.
const SHORT: f64 = 0.2;
/// No input takes as long. Generous: other tests run beside it, on machines that may be slow.
const MAX_SECONDS: u64 = 20;
/// The most memory that the reader of an input below a megabyte may hold, with the program and its tables.
const MAX_BYTES: u64 = 600 << 20;

/// Set in the process that runs a target: its name, and the file that holds the input at hand.
const TARGET: &str = "DJINN_FUZZ_TARGET";
const INPUT: &str = "DJINN_FUZZ_INPUT";

#[test]
fn readers_of_damaged_files_end_in_results_or_errors() {
    let seconds = std::env::var("DJINN_FUZZ_SECONDS").map_or(SHORT, |text| text.parse().unwrap());
    let queue = Mutex::new(TARGETS.iter());
    // The lock is not held while a target runs.
    let next = || queue.lock().unwrap().next();
    let work = || std::iter::from_fn(next).for_each(|target| run_in_process(target, seconds));
    let n_threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..n_threads.min(TARGETS.len())).map(|_| scope.spawn(work)).collect();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    });
}

/// Runs a target in a process of its own; fails when that fails or does not end.
fn run_in_process(target: &Target, seconds: f64) {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("input");
    let (said, errors) = (folder.path().join("said"), folder.path().join("errors"));
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "fuzz::one_target", "--nocapture", "--test-threads=1"])
        .env(TARGET, target.name)
        .env(INPUT, &input)
        .env("DJINN_FUZZ_SECONDS", seconds.to_string())
        .stdout(fs_err::File::create(&said).unwrap().into_parts().0)
        .stderr(fs_err::File::create(&errors).unwrap().into_parts().0)
        .spawn()
        .unwrap();
    let limit = Duration::from_secs_f64(seconds) + Duration::from_secs(MAX_SECONDS) * 3;
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() && began.elapsed() < limit {
        std::thread::sleep(Duration::from_millis(10));
    }
    // One that has ended cannot be killed.
    let _ = child.kill();
    let status = child.wait().unwrap();
    let said = fs_err::read_to_string(said).unwrap();
    if !status.success() {
        let kept = std::env::temp_dir().join(format!("djinn-fuzz-{}", target.name));
        fs_err::copy(&input, &kept).unwrap();
        let errors = fs_err::read_to_string(errors).unwrap();
        panic!("{}: {status} over the input in {}\n{said}\n{errors}", target.name, kept.display());
    }
    for line in said.lines().filter(|line| line.starts_with("fuzz ")) {
        std::io::stdout().write_all(format!("{line}\n").as_bytes()).unwrap();
    }
}

/// In a process of its own, which the test above starts: runs the target that the environment names. Elsewhere there is
/// none.
#[test]
fn one_target() {
    let Ok(name) = std::env::var(TARGET) else { return };
    let target = TARGETS.iter().find(|target| target.name == name).unwrap();
    let input = std::env::var(INPUT).unwrap();
    let seconds: f64 = std::env::var("DJINN_FUZZ_SECONDS").unwrap().parse().unwrap();
    let seed: u64 = std::env::var("DJINN_FUZZ_SEED").map_or(1, |text| text.parse().unwrap());
    run(target, Path::new(&input), Duration::from_secs_f64(seconds), seed);
}

fn run(target: &Target, input: &Path, time: Duration, seed: u64) {
    let folder = tempfile::tempdir().unwrap();
    let seeds = (target.seeds)(folder.path());
    for seed in &seeds {
        fs_err::write(input, seed).unwrap();
        assert!((target.read)(folder.path(), seed), "{}: a file as it was made cannot be read", target.name);
    }
    let strategy = damaged(seeds);
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &[seed.to_le_bytes(); 4].concat());
    let mut runner = TestRunner::new_with_rng(Config::default(), rng);
    let (began, mut n_executions, mut n_read) = (Instant::now(), 0_u64, 0_u64);
    while began.elapsed() < time {
        let bytes = strategy.new_tree(&mut runner).unwrap().current();
        fs_err::write(input, &bytes).unwrap();
        let began = Instant::now();
        n_read += u64::from((target.read)(folder.path(), &bytes));
        n_executions += 1;
        let (elapsed, peak) = (began.elapsed(), peak_bytes());
        assert!(elapsed < Duration::from_secs(MAX_SECONDS), "an input took {} s", elapsed.as_secs());
        assert!(peak < MAX_BYTES, "an input of {} bytes took {} MB", bytes.len(), peak >> 20);
    }
    assert!(n_executions > 0, "nothing was tried");
    let peak = peak_bytes() >> 20;
    // The harness has begun the line with the name of the test.
    let said = format!(
        "\nfuzz {}: {n_executions} executions, {n_read} of them readable, peak memory {peak} MB\n",
        target.name
    );
    std::io::stdout().write_all(said.as_bytes()).unwrap();
}

/// The most memory that the process ever held; 0 where the system does not say.
fn peak_bytes() -> u64 {
    let status = fs_err::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = peak.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}
