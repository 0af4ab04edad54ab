//! Errors that stop a closed loop. A driver that fails is not an error but the outcome of a scenario.

use crate::{generate, store};
use std::path::PathBuf;

/// A failure of a closed loop.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// A setting that cannot work.
    #[error("{0}")]
    Config(String),
    /// A planner that never runs.
    #[error("the planner `{command}` does not run: {why}")]
    Planner { command: String, why: String },
    /// The machine has no more processes, threads or memory.
    #[error("{0}")]
    Machine(String),
    /// A scenario that the model cannot continue.
    #[error("scenario {scenario_id} {why}")]
    Unfit { scenario_id: String, why: String },
    /// A saved state that cannot be read, or does not fit the corpus.
    #[error("{path}: {why}")]
    State { path: PathBuf, why: String },
    /// Sampling failed.
    #[error(transparent)]
    Generate(#[from] generate::Error),
    /// A table could not be read or written.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// A file could not be read.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// The result of a simulation that may fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;
