//! Errors of our own files, and what the user can do about them.

use crate::files;
use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// A failure to read or write one of our files.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system refused; the message names the path.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// A folder that must not be written into.
    #[error(transparent)]
    Files(files::Error),
    /// A folder without its manifest, which is written last.
    #[error(
        "{} has no manifest.json, so the command that writes it did not finish; run that command again",
        .dir.display()
    )]
    Unfinished {
        /// The folder.
        dir: PathBuf,
    },
    /// A folder that is not a corpus.
    #[error("{} is not a corpus: it has no corpus manifest.json; {}", .dir.display(), what_to_name(.inside.as_deref()))]
    NoCorpus {
        /// The folder.
        dir: PathBuf,
        /// A corpus inside it, as in run folders.
        inside: Option<PathBuf>,
    },
    /// A file with another schema, or another version of it.
    #[error(
        "{} has schema `{found}`, expected `{expected}`; write it again with this version of djinn",
        .path.display()
    )]
    SchemaVersion {
        /// The file.
        path: PathBuf,
        /// The schema that this version reads, such as `scene.v1`.
        expected: String,
        /// The schema that the file names; empty if it names none.
        found: String,
    },
    /// A file whose content is not as it was written.
    #[error(
        "{} is damaged: {detail}; restore it from a copy, or move its folder away and run the command that writes it \
         again",
        .path.display()
    )]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Description of the fault.
        detail: String,
    },
    /// A record of a run whose content is not as it was written. The remedy depends on the record.
    #[error("{} is damaged: {detail}", .path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// Description of the fault.
        detail: String,
    },
    /// A value that cannot be stored faithfully.
    #[error("cannot store {id}: {detail}")]
    Invalid {
        /// The scene, scenario, event or table.
        id: String,
        /// Why not.
        detail: String,
    },
    /// A file from elsewhere that does not hold what it should.
    #[error("cannot read {}: {detail}", .path.display())]
    Unfit {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what was expected.
        detail: String,
    },
    /// Two scenes of one name.
    #[error(
        "two scenes that differ are called {id}, {}; give only the recording that is right, or each a name of its own",
        from_both(.files)
    )]
    DuplicateScene {
        /// The scene.
        id: String,
        /// The recordings within their folders or archives, the earlier one first.
        files: [String; 2],
    },
    /// A map that is in no table.
    #[error("map {map_id} is not among the maps of {}", .path.display())]
    UnknownMap {
        /// The map.
        map_id: String,
        /// The place that was searched.
        path: PathBuf,
    },
    /// A position or name that is not in a table.
    #[error("{} holds no {what}", .path.display())]
    NotFound {
        /// The file or folder.
        path: PathBuf,
        /// The item requested, such as `scene 12 of 10`.
        what: String,
    },
    /// JSON that does not have the expected form.
    #[error("cannot read or write {}: {source}", .path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: serde_json::Error,
    },
    /// Arrow cannot encode or decode a table.
    #[error("cannot encode or decode {}: {source}", .path.display())]
    Arrow {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: arrow::error::ArrowError,
    },
    /// Parquet cannot encode or decode a table.
    #[error("cannot encode or decode {}: {source}", .path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: parquet::errors::ParquetError,
    },
    /// A group-by failed.
    #[error("cannot summarize {table}: {source}")]
    Frame {
        /// The table summarized.
        table: &'static str,
        /// The cause.
        source: polars::prelude::PolarsError,
    },
}

impl From<files::Error> for Error {
    fn from(error: files::Error) -> Self {
        match error {
            files::Error::Io(error) => Self::Io(error),
            error => Self::Files(error),
        }
    }
}

/// Files are named within their inputs, and two inputs may have files of the same name.
fn from_both([one, other]: &[String; 2]) -> String {
    if one == other { format!("both from files called {one}") } else { format!("from {one} and from {other}") }
}

fn what_to_name(inside: Option<&Path>) -> String {
    match inside {
        Some(inside) => format!("the corpus in it is {}", inside.display()),
        None => "pass the folder that `djinn evaluate` wrote, such as output/quickstart/main/corpus".to_owned(),
    }
}

impl Error {
    /// A file whose content is not as it was written.
    pub(crate) fn corrupt(path: &Path, detail: impl Into<String>) -> Self {
        Self::Corrupt { path: path.to_owned(), detail: detail.into() }
    }

    /// A file that could not be read: damage, or a failure of the system, after which the file may well be whole.
    pub(crate) fn unreadable(path: &Path, cause: impl Display) -> Self {
        let cause = cause.to_string();
        // Readers of tables pass on the system's errors as texts.
        match cause.contains("(os error ") {
            true => Self::Io(io::Error::other(format!("failed to read {}: {cause}", path.display()))),
            false => Self::corrupt(path, cause),
        }
    }

    /// A value that cannot be stored faithfully.
    pub(crate) fn invalid(id: &(impl ToString + ?Sized), detail: impl Into<String>) -> Self {
        Self::Invalid { id: id.to_string(), detail: detail.into() }
    }

    /// For `map_err` on results of Parquet.
    pub(crate) fn parquet(path: &Path) -> impl FnOnce(parquet::errors::ParquetError) -> Self {
        let path = path.to_owned();
        move |source| match source {
            // Parquet wraps the errors of its writer; a full disk should read as a full disk.
            parquet::errors::ParquetError::External(cause) => match cause.downcast::<io::Error>() {
                Ok(io) => Self::Io(*io),
                Err(cause) => Self::Parquet { path, source: parquet::errors::ParquetError::External(cause) },
            },
            source => Self::Parquet { path, source },
        }
    }

    /// For `map_err` on results of JSON.
    pub(crate) fn json(path: &Path) -> impl FnOnce(serde_json::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Json { path, source }
    }
}

/// The results of this layer.
pub type Result<T> = std::result::Result<T, Error>;
