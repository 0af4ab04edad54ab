//! Errors of exports, with remedies.

use crate::{files, store};
use std::path::PathBuf;

/// A failure to export.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// The file system refused; the message names the path.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The corpus cannot be read, or a file of ours cannot be written.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// A folder that must not be written into: an export has a folder of its own.
    #[error(transparent)]
    Files(#[from] files::Error),
    /// No scenario passes the selection.
    #[error("none of the {n_scenarios} scenarios of {} is {wanted}", .corpus.display())]
    NothingSelected { corpus: PathBuf, n_scenarios: usize, wanted: String },
    /// The format is for recordings and cannot leave the ego free.
    #[error("{format} cannot leave the ego free: it is a format of recordings; use commonroad or openscenario")]
    EgoIsReplayed { format: &'static str },
    /// The format cannot represent any of the scenarios.
    #[error("none of the {n_scenarios} scenarios can be represented as {format}: {reasons}")]
    NothingWritten { format: &'static str, n_scenarios: u64, reasons: String },
    /// A table could not be encoded.
    #[error("cannot encode {}: {detail}", .path.display())]
    Encode { path: PathBuf, detail: String },
}

impl Error {
    /// For `map_err` on the results of the encoder of `path`.
    pub(super) fn encode<E: std::fmt::Display>(path: &std::path::Path) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |error| Self::Encode { path, detail: error.to_string() }
    }
}

/// The results of this module.
pub type Result<T> = std::result::Result<T, Error>;
