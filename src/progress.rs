//! Reports the progress of long work, without knowing who listens, and asks whether to stop it.

/// Receives the progress of one piece of work; the default of each method ignores it. Implementations must tolerate
/// calls from several threads.
#[expect(unused_variables, reason = "by default, reports are ignored")]
pub trait Progress: Sync {
    /// Begins a phase of `total` units (0 when unknown), for instance `("ingest", 1990, "scenes")`.
    fn start(&self, phase: &str, total: u64, unit: &str) {}
    /// Reports `n` more finished units of the current phase.
    fn advance(&self, n: u64) {}
    /// Shows a short state of the current phase beside the bar, such as the current loss.
    fn note(&self, message: &str) {}
    /// Reports something the user must see, such as a rejected file; it also goes to the log.
    fn warn(&self, message: &str) {}
    /// Ends the current phase.
    fn finish(&self) {}
    /// Whether to stop as soon as the finished work is saved. A phase that has called this once is given the time to
    /// save; one that never calls it is ended at once.
    fn must_stop(&self) -> bool {
        false
    }
}

/// Ignores all reports; for tests and library use.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {}

/// Keeps warnings.
#[cfg(test)]
#[derive(Default)]
pub(crate) struct Heard(std::sync::Mutex<Vec<String>>);

#[cfg(test)]
impl Heard {
    /// The warnings until now.
    pub(crate) fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap())
    }
}

#[cfg(test)]
impl Progress for Heard {
    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
}
