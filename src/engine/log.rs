//! The log of a run, for reading afterwards: `log.txt`.

use super::clock::utc_now;
use super::kind::StageKind;
use crate::progress::Progress;
use fs_err::File;
use std::io::Write;
use std::path::Path;
use std::sync::Mutex;

/// Passes progress on to another receiver and logs the events: phases, warnings and messages, but not every advance.
pub(super) struct Logged<'a> {
    inner: &'a dyn Progress,
    state: Mutex<LogState>,
}

struct LogState {
    file: File,
    stage: Option<&'static StageKind>,
    phase: String,
    n_done: u64,
}

/// Name of the log within a run folder.
pub(super) const LOG_FILE: &str = "log.txt";

impl<'a> Logged<'a> {
    /// Appends to the log at `path`.
    pub(super) fn open(path: &Path, inner: &'a dyn Progress) -> std::io::Result<Self> {
        let file = File::options().create(true).append(true).open(path)?;
        Ok(Self { inner, state: Mutex::new(LogState { file, stage: None, phase: String::new(), n_done: 0 }) })
    }

    /// Writes a line into the log alone.
    pub(super) fn line(&self, message: &str) {
        self.with(|state| state.line(message));
    }

    /// Phases that start from now on are those of `stage`.
    pub(super) fn enter(&self, stage: &'static StageKind) {
        self.with(|state| state.stage = Some(stage));
    }

    fn with<T>(&self, act: impl FnOnce(&mut LogState) -> T) -> T {
        // A thread that panicked while writing a line leaves half a line at worst.
        act(&mut self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }
}

impl LogState {
    fn line(&mut self, message: &str) {
        // A log that cannot be written (a full disk) must not end the work: the outputs will report the problem if they
        // fail, too.
        let _ = writeln!(self.file, "{} {message}", utc_now());
    }
}

impl Progress for Logged<'_> {
    fn start(&self, phase: &str, total: u64, unit: &str) {
        let phase = self.with(|state| {
            let phase = state.stage.map_or_else(|| phase.to_owned(), |stage| stage.phase(phase));
            (state.phase, state.n_done) = (phase.clone(), 0);
            let of = if total == 0 { String::new() } else { format!(" ({total} {unit})") };
            state.line(&format!("{phase}: started{of}"));
            phase
        });
        self.inner.start(&phase, total, unit);
    }

    fn advance(&self, n: u64) {
        self.with(|state| state.n_done += n);
        self.inner.advance(n);
    }

    fn note(&self, message: &str) {
        self.inner.note(message);
    }

    fn warn(&self, message: &str) {
        self.with(|state| state.line(&format!("warning: {message}")));
        self.inner.warn(message);
    }

    fn finish(&self) {
        self.with(|state| {
            let line = format!("{}: finished {}", state.phase, state.n_done);
            state.line(&line);
        });
        self.inner.finish();
    }

    fn must_stop(&self) -> bool {
        self.inner.must_stop()
    }
}
