//! Benchmarks: how long do the parts that matter take on this machine?
//!
//! ```sh
//! cargo bench --profile dev -- run_time                # seconds for a scene against the number of its agents
//! cargo bench --profile dev -- run_time 8 16 --steps 25
//! cargo bench --profile dev -- network SCENES            # beside PyTorch, on the folder `scenes` of a run
//! cargo bench -- stages                                  # whole runs beside the last release's
//! ```
//!
//! The profile `dev` has optimized dependencies, and so saves a second build of the world;
//! `CARGO_PROFILE_DEV_OPT_LEVEL=3` before it optimizes our own code, too. `RAYON_NUM_THREADS` limits
//! the threads; set `CANDLE_NUM_THREADS=1`, as the program does for itself. What is measured goes to stdout as a table;
//! CI checks that this compiles, and never looks at a time.
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a program of its own, for people")]

#[path = "../it/batch_tensors.rs"]
mod batch_tensors;
mod cpu_time;
mod network;
mod run_time;
mod scenes;
mod stages;

use std::process::ExitCode;

fn main() -> ExitCode {
    // Cargo adds `--bench` to the arguments.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let result = match arguments.split_first() {
        Some((name, rest)) if name == "run_time" => run_time::run(rest),
        Some((name, rest)) if name == "network" => network::run(rest),
        Some((name, rest)) if name == "stages" => stages::run(rest),
        _ => Err("name a benchmark: run_time [AGENTS …] [--steps N …], network SCENES or stages".to_owned()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}
