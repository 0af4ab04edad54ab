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
        // Candle reads it when it first computes.
        std::env::set_var("CANDLE_NUM_THREADS", "1");
    }
}
