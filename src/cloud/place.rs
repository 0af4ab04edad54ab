//! The place on disk for a path or URL that the user named.

use super::ObjectUrl;
use super::error::Result;
#[cfg(feature = "cloud")]
use super::mirrored::Mirrored;
#[cfg(not(feature = "cloud"))]
use super::no_stores::Mirrored;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

static CACHE_DIR: OnceLock<PathBuf> = OnceLock::new();

/// Chooses the folder for downloads in this process; the first choice counts.
pub fn use_cache_dir(dir: &Path) {
    let _ = CACHE_DIR.set(dir.to_owned());
}

/// The folder that was chosen.
#[cfg(feature = "cloud")]
pub(super) fn cache_dir() -> Option<&'static Path> {
    CACHE_DIR.get().map(PathBuf::as_path)
}

/// The use that a command makes of a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Reads everything.
    Read,
    /// Reads the progress of the work.
    Look,
    /// Makes shards, as one of several workers.
    Work,
    /// Writes, alone.
    Write,
}

/// A file or folder on disk that the user named, or that shows a URL that the user named.
#[derive(Debug)]
pub struct Place {
    path: PathBuf,
    shown: Option<Mirrored>,
}

impl Place {
    /// A path on disk as it is; for a URL, a folder with the objects that the command needs. A folder that does not
    /// exist is shown empty.
    ///
    /// # Errors
    /// When the URL cannot be read, or this build does not support URLs; errors of the store.
    pub fn open(path: &Path, access: Access) -> Result<Self> {
        let Some(url) = ObjectUrl::of(path)? else { return Ok(Self { path: path.to_owned(), shown: None }) };
        let shown = Mirrored::open(&url, access, CACHE_DIR.get().map(PathBuf::as_path))?;
        Ok(Self { path: shown.path().to_owned(), shown: Some(shown) })
    }

    /// The path on disk.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Uploads written files that belong into a bucket and are not there yet.
    ///
    /// # Errors
    /// On errors of the store, or if something else has written to the bucket meanwhile.
    pub fn finish(self) -> Result<()> {
        self.shown.map_or(Ok(()), |shown| shown.finish())
    }
}
