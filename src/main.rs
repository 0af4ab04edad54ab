//! The `djinn` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    djinn::cli::main()
}
