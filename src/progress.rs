//! How far a long piece of work has come, without knowing who is told; and whether it is asked to stop.

/// Receives the progress of one piece of work. Implementations must tolerate calls from several threads.
pub trait Progress: Sync {
    /// Begins a phase of `total` units (0 when unknown), for instance `("ingest", 1990, "scenes")`.
    fn start(&self, phase: &str, total: u64, unit: &str);
    /// Reports `n` more finished units of the current phase.
    fn advance(&self, n: u64);
    /// Shows a short state of the current phase beside the bar, such as the current loss.
    fn note(&self, message: &str);
    /// Reports something the user must see, such as a rejected file; it also goes to the log.
    fn warn(&self, message: &str);
    /// Ends the current phase.
    fn finish(&self);
    /// Whether the work is to stop as soon as what it has done can be kept. A phase that has asked once is given the time for it; one
    /// that never asks is ended at once.
    fn must_stop(&self) -> bool;
}

/// Tells nobody; for tests and library use.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn start(&self, _phase: &str, _total: u64, _unit: &str) {}
    fn advance(&self, _n: u64) {}
    fn note(&self, _message: &str) {}
    fn warn(&self, _message: &str) {}
    fn finish(&self) {}
    fn must_stop(&self) -> bool {
        false
    }
}
