//! Why can an object store not be used, and who can fix it?

use super::ObjectUrl;
use crate::files;
use crate::settings::Unreadable;
use std::io;

/// Errors of object stores. No message holds a credential.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// An invalid URL.
    #[error(transparent)]
    Url(#[from] Unreadable),
    /// A build without the feature.
    #[error(
        "cannot open {url}: this djinn was built without object stores; use one that was built with them \
         (`cargo build --release --features cloud`), or copy the files to disk"
    )]
    NotBuilt { url: ObjectUrl },
    /// Nothing is there.
    #[error("{url} does not exist, neither as an object nor as a folder of objects")]
    Missing { url: ObjectUrl },
    /// The store does not let us.
    #[error("cannot {doing} {url}: {why}; check the credentials and the settings of the store in the environment")]
    Denied { doing: &'static str, url: ObjectUrl, why: String },
    /// The store, or the way there, does not work.
    #[error("cannot {doing} {url}: tried {n_attempts} times in {seconds:.0} s; last: {why}")]
    Failed { doing: &'static str, url: ObjectUrl, n_attempts: usize, seconds: f64, why: String },
    /// Objects of others where results would be copied to.
    #[error("{url} was not written by djinn; nothing was changed there; remove it, or choose another output")]
    Foreign { url: ObjectUrl },
    /// An object that was replaced while it was downloaded.
    #[error("{url} was replaced while it was read; run the same command again once it stays as it is")]
    Replaced { url: ObjectUrl },
    /// A name that cannot be a file.
    #[error("{url} cannot be kept on disk: its name is no relative path; move it out of the folder")]
    Unnamable { url: ObjectUrl },
    /// No folder of this machine.
    #[error("no folder for what is in object stores is known: pass --cache-dir, or set DJINN_CACHE_DIR")]
    NoCache,
    /// The disk does not work.
    #[error(transparent)]
    Files(#[from] files::Error),
}

impl Error {
    /// Whether the user can mend it; otherwise the machine failed.
    pub fn is_refusal(&self) -> bool {
        match self {
            Self::Failed { .. } => false,
            Self::Files(error) => !matches!(error, files::Error::Io(_)),
            _ => true,
        }
    }
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Self {
        Self::Files(error.into())
    }
}

/// The results of this module.
pub type Result<T, E = Error> = std::result::Result<T, E>;
