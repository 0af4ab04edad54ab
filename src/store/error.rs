//! Errors of our own files, and what the user can do about them.

use crate::files;
use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// A failure to read or write one of our files.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
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
    Unfinished { dir: PathBuf },
    /// A folder that is not a corpus.
    #[error("{} is not a corpus: it has no corpus manifest.json; {}", .dir.display(), what_to_name(.inside.as_deref()))]
    NoCorpus { dir: PathBuf, inside: Option<PathBuf> },
    /// A file with another schema, or another version of it.
    #[error(
        "{} has schema `{found}`, expected `{expected}`; write it again with this version of djinn",
        .path.display()
    )]
    SchemaVersion { path: PathBuf, expected: String, found: String },
    /// A file whose content is not as it was written.
    #[error(
        "{} is damaged: {detail}; restore it from a copy, or move its folder away and run the command that writes it \
         again",
        .path.display()
    )]
    Corrupt { path: PathBuf, detail: String },
    /// A record of a run whose content is not as it was written. The remedy depends on the record.
    #[error("{} is damaged: {detail}", .path.display())]
    Record { path: PathBuf, detail: String },
    /// A value that cannot be stored faithfully.
    #[error("cannot store {id}: {detail}")]
    Invalid { id: String, detail: String },
    /// A file from elsewhere that does not hold what it should.
    #[error("cannot read {}: {detail}", .path.display())]
    Unfit { path: PathBuf, detail: String },
    /// Two scenes of one name.
    #[error(
        "two scenes that differ are called {id}, {}; give only the recording that is right, or each a name of its own",
        from_both(.files)
    )]
    DuplicateScene { id: String, files: [String; 2] },
    /// A map that is in no table.
    #[error("map {map_id} is not among the maps of {}", .path.display())]
    UnknownMap { map_id: String, path: PathBuf },
    /// A position or name that is not in a table.
    #[error("{} holds no {what}", .path.display())]
    NotFound { path: PathBuf, what: String },
    /// JSON that does not have the expected form.
    #[error("cannot read or write {}: {source}", .path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    /// Arrow cannot encode or decode a table.
    #[error("cannot encode or decode {}: {source}", .path.display())]
    Arrow { path: PathBuf, source: arrow::error::ArrowError },
    /// Parquet cannot encode or decode a table.
    #[error("cannot encode or decode {}: {source}", .path.display())]
    Parquet { path: PathBuf, source: parquet::errors::ParquetError },
    /// A group-by failed.
    #[error("cannot summarize {table}: {source}")]
    Frame { table: &'static str, source: polars::prelude::PolarsError },
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
