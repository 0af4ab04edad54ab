//! Errors of the tools for corpora, with remedies.

use crate::{files, store};
use std::path::{Path, PathBuf};

/// A failure of a tool.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// A corpus cannot be read or written.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// The file system refused; the message names the path.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// A condition that cannot be understood.
    #[error("condition `{text}`: {detail}")]
    Condition { text: String, detail: String },
    /// A column that the scenarios do not have.
    #[error("scenarios have no column `{name}`{hint}")]
    UnknownColumn { name: String, hint: String },
    /// A folder that must not be written into.
    #[error(transparent)]
    Files(#[from] files::Error),
    /// Two corpora hold different scenarios under one id.
    #[error(
        "scenario {id} is in {} and in {} with different content; filter it out of one of them first",
        .first.display(), .second.display()
    )]
    Conflict { id: String, first: PathBuf, second: PathBuf },
    /// Two corpora hold different maps under one name.
    #[error(
        "map {id} of {} differs from the map of the same name in an earlier corpus; corpora with different maps cannot \
         be merged",
        .dir.display()
    )]
    MapConflict { id: String, dir: PathBuf },
    /// A choice that cannot be.
    #[error("{0}")]
    Usage(String),
}

impl Error {
    /// Rows that cannot be brought together although their schemas were checked.
    pub(super) fn arrow(path: &Path) -> impl FnOnce(arrow::error::ArrowError) -> Self {
        let path = path.to_owned();
        move |error| Self::Store(store::Error::unreadable(&path, error))
    }
}

/// The results of tools.
pub type Result<T, E = Error> = std::result::Result<T, E>;
