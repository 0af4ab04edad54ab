//! Errors that stop a closed loop. A driver that fails is not an error but the outcome of a scenario.

use crate::{generate, store};
use std::path::PathBuf;

/// A failure of a closed loop.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting that cannot work.
    #[error("{0}")]
    Config(String),
    /// A planner that never runs.
    #[error("the planner `{command}` does not run: {why}")]
    Planner {
        /// The command.
        command: String,
        /// What happens to it.
        why: String,
    },
    /// The machine has no more processes, threads or memory.
    #[error("{0}")]
    Machine(String),
    /// A scenario that the model cannot continue.
    #[error("scenario {scenario_id} {why}")]
    Unfit {
        /// The scenario.
        scenario_id: String,
        /// Why, in words that follow the scenario's name.
        why: String,
    },
    /// A saved state that cannot be read, or does not fit the corpus.
    #[error("{path}: {why}")]
    State {
        /// The file.
        path: PathBuf,
        /// The fault, and the remedy.
        why: String,
    },
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
