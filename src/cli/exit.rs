//! Which exit code does the program end with? The help text lists them too.

use crate::engine::{Blame, Failure};
use std::process::ExitCode;

/// Everything was done.
pub(super) const DONE: ExitCode = ExitCode::SUCCESS;

/// The exit code after which running the same command again continues, for schedulers that retry jobs (EX_TEMPFAIL of
/// `sysexits.h`).
pub(super) const LATER: u8 = 75;

pub(super) fn of_failure(failure: &Failure) -> ExitCode {
    ExitCode::from(match failure.blame {
        Blame::Input => 1,
        Blame::Fault => 2,
        Blame::Gate => 3,
        Blame::Later => LATER,
    })
}

/// Prints clap's message (help is no error) and returns its exit code.
pub(super) fn of_usage(error: &clap::Error) -> ExitCode {
    // Nobody reads the message if the terminal is gone.
    let _ = error.print();
    if error.use_stderr() { ExitCode::from(1) } else { DONE }
}
