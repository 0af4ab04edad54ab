//! Errors that stop a drive. A planner that fails is not an error but the outcome of a scenario.

use crate::{files, generate, store};
use std::path::PathBuf;

/// A failure of a drive.
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
    /// No scenario passes the selection.
    #[error("none of the {n_scenarios} scenarios in {corpus} is {wanted}")]
    NothingSelected {
        /// The corpus.
        corpus: PathBuf,
        /// The number of its scenarios.
        n_scenarios: usize,
        /// The selection in words.
        wanted: String,
    },
    /// Sampling failed.
    #[error(transparent)]
    Generate(#[from] generate::Error),
    /// A table could not be read or written.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// An output could not be put in its place.
    #[error(transparent)]
    Files(#[from] files::Error),
    /// A file could not be read or written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// The result of a drive that may fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;
