//! How is a text handed to an engine's command?

use crate::pipeline::{Classify, Failure, Result};
use std::io::Write;
use std::process::{Command, Output, Stdio};

/// Runs `program`, which is `what`, with a text as its input. Returns what came of it, failed or not.
///
/// # Errors
/// When the program is not there.
pub(super) fn feed(program: &str, what: &str, args: &[String], text: &str) -> Result<Output> {
    let missing = |error| {
        Failure::input(anyhow::Error::new(error).context(format!("failed to start {program}, {what}")))
            .with_hint("run this where it is installed; --dry-run prints the jobs without it")
    };
    let mut command = Command::new(program);
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(missing)?;
    if let Some(mut stdin) = child.stdin.take() {
        // One that refuses its arguments need not read: what it says counts.
        let _ = stdin.write_all(text.as_bytes());
    }
    child.wait_with_output().blame_fault()
}

/// What a program that failed says of it.
pub(super) fn complaint(output: &Output) -> String {
    let (said, why) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let why = if why.trim().is_empty() { said } else { why };
    why.trim().to_owned()
}
