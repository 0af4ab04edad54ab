//! Feeds the command of an engine with its input.

use crate::engine::{Classify, Failure, Result};
use std::io::Write;
use std::process::{Command, Output, Stdio};

/// Runs `program` with a text as its standard input and returns its output, whether it failed or not. `what` describes
/// the program in errors.
pub(super) fn feed(program: &str, what: &str, args: &[String], text: &str) -> Result<Output> {
    let missing = |error| {
        Failure::input(anyhow::Error::new(error).context(format!("failed to start {program}, {what}")))
            .with_hint("run this command on a machine that has it; --dry-run prints the jobs without it")
    };
    let mut command = Command::new(program);
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(missing)?;
    if let Some(mut stdin) = child.stdin.take() {
        // A program that refuses its arguments may not read its input; its message matters then, not the broken pipe.
        let _ = stdin.write_all(text.as_bytes());
    }
    child.wait_with_output().blame_fault()
}

/// The message of a program that failed.
pub(super) fn complaint(output: &Output) -> String {
    let (said, why) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let why = if why.trim().is_empty() { said } else { why };
    why.trim().to_owned()
}
