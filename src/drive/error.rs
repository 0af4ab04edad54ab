//! Errors that stop a drive. A planner that fails is not an error but the outcome of a scenario.

use crate::{files, simulate, store};
use std::path::PathBuf;

/// A failure of a drive.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// A setting that cannot work.
    #[error("{0}")]
    Config(String),
    /// No scenario passes the selection.
    #[error("none of the {n_scenarios} scenarios in {corpus} is {wanted}")]
    NothingSelected { corpus: PathBuf, n_scenarios: usize, wanted: String },
    /// Every selected scenario is left out.
    #[error("none of the {n_chosen} chosen scenarios can be driven: {why}")]
    NothingDriven { n_chosen: usize, why: String },
    /// A closed loop failed.
    #[error(transparent)]
    Simulate(#[from] simulate::Error),
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
