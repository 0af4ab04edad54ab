//! The `djinn` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    keep_candle_in_its_caller();
    djinn::cli::main()
}

/// Keeps candle's large operations on the thread that calls them: its own pool has a thread for each core of the
/// machine, whatever `--threads` says, serves one caller at a time, and its callers wait for it in a busy loop.
fn keep_candle_in_its_caller() {
    #[expect(unsafe_code, reason = "variables of the process have no safe setter")]
    // SAFETY: this is the first action of the program; no other thread exists that could read them.
    unsafe {
        // Candle reads them when it first computes. Without the second, it counts the cores of the machine, by reading
        // `/proc/cpuinfo`, for every product of matrices.
        std::env::set_var("CANDLE_NUM_THREADS", "1");
        std::env::set_var("CANDLE_CPU_MASK", "0");
    }
}
