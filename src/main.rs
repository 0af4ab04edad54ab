//! The `djinn` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    let_waiting_threads_sleep();
    djinn::cli::main()
}

/// Makes candle's worker threads sleep soon when they have nothing to do. By default they wait in a busy loop, on the
/// cores that the threads of the fused operations need: with two threads a training step took 30 % longer.
fn let_waiting_threads_sleep() {
    /// Rounds of the loop; candle reads it when it first computes in parallel.
    const SPIN_LIMIT: &str = "CANDLE_BARRIER_POOL_SPIN_LIMIT";
    if std::env::var_os(SPIN_LIMIT).is_none() {
        #[expect(unsafe_code, reason = "variables of the process have no safe setter")]
        // SAFETY: this is the first action of the program; no other thread exists that could read them.
        unsafe {
            std::env::set_var(SPIN_LIMIT, "1");
        }
    }
}
