//! What may be printed, where, and in which colors?

use super::args::OutputArgs;
use crate::engine::{Blame, Failure, Result, version};
use crate::files::in_their_names;
use clap::ColorChoice;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

/// Decides what is printed, where and how.
#[derive(Debug, Clone, Copy)]
pub(super) struct Printer {
    quiet: bool,
    color: bool,
}

impl Printer {
    pub(super) fn new(output: &OutputArgs) -> Self {
        let no_color = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        let dumb = std::env::var_os("TERM").is_some_and(|value| value == "dumb");
        let color = match output.color {
            ColorChoice::Always => true,
            ColorChoice::Never => false,
            ColorChoice::Auto => !no_color && !dumb && io::stderr().is_terminal(),
        };
        Self { quiet: output.quiet, color }
    }

    /// Prints the command's results to stdout, with control characters escaped as JSON does. A closed pipe (`| head`)
    /// is not an error.
    pub(super) fn data(&self, text: &str) -> Result<()> {
        let mut stdout = io::stdout().lock();
        let text = shown(text, |c| format!("\\u{:04x}", u32::from(c)));
        match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Reports progress to stderr; nothing when quiet.
    pub(super) fn message(&self, message: impl Display) {
        if !self.quiet {
            stderr_line(&plain(&message.to_string()));
        }
    }

    /// Reports a failure with all its causes and the advice, to stderr; without advice of its own, `left` tells what an
    /// interruption leaves behind.
    pub(super) fn failure(&self, failure: &Failure, left: Option<&str>) {
        let mut causes = failure.error.chain().map(ToString::to_string);
        let mut text = causes.next().unwrap_or_default();
        let mut last = text.clone();
        for cause in causes {
            // Errors that show their source in their own message would be printed twice.
            if !last.contains(&cause) {
                text.push_str(&format!("\n  caused by: {cause}"));
            }
            last = cause;
        }
        let is_later = failure.blame == Blame::Later;
        let head = if is_later { self.paint("stopped", "1;33") } else { self.paint("error", "1;31") };
        stderr_line(&format_args!("{head}: {}", plain(&text)));
        if let Some(hint) = failure.hint.as_deref().or(left.filter(|_| is_later)) {
            stderr_line(&format_args!("{}: {}", self.paint("hint", "1;36"), plain(hint)));
        }
    }

    /// A warning about something odd that stops nothing.
    pub(super) fn warning_line(&self, message: &str) -> String {
        format!("{}: {}", self.paint("warning", "1;33"), plain(message))
    }

    fn paint(&self, text: &str, code: &str) -> String {
        if self.color { format!("\u{1b}[{code}m{text}\u{1b}[0m") } else { text.to_owned() }
    }
}

/// The text with URLs in place of their local copies, and with control characters escaped except tabs and ends of
/// lines: terminals obey them, and names of files and of archive entries come from others.
fn plain(text: &str) -> String {
    shown(&in_their_names(text), |c| c.escape_debug().to_string())
}

/// The text with control characters other than tabs and ends of lines in the form that `escape` gives them.
fn shown(text: &str, escape: fn(char) -> String) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_control() && !matches!(c, '\n' | '\t') { shown.push_str(&escape(c)) } else { shown.push(c) }
    }
    shown
}

/// Prints the program's name and version, as results name it.
pub(super) fn version_line() {
    let _ = writeln!(io::stdout().lock(), "djinn {}", version().as_deref().unwrap_or(env!("CARGO_PKG_VERSION")));
}

/// Prints a line on stderr. Failure is ignored: nobody could read a message about it.
pub(super) fn stderr_line(line: &dyn Display) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_shown_and_not_obeyed() {
        assert_eq!(plain("a\u{1b}[31mb\r\u{7}\u{9b}c"), "a\\u{1b}[31mb\\r\\u{7}\\u{9b}c");
        assert_eq!(plain("two\n\tlines, ü and 車"), "two\n\tlines, ü and 車");
    }
}
