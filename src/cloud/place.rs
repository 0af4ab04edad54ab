//! Where on disk is what the user named, be it a path or a URL?

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
    /// It reads everything.
    Read,
    /// It reads how far the work is.
    Look,
    /// It makes shards, as one of several workers.
    Work,
    /// It writes, alone.
    Write,
}

/// A file or folder on disk that is, or shows, what the user named.
#[derive(Debug)]
pub struct Place {
    path: PathBuf,
    shown: Option<Mirrored>,
}

impl Place {
    /// A path on disk as it is; of a URL, what the command needs of it. A folder that does not exist is shown empty.
    ///
    /// # Errors
    /// When the URL cannot be read, or this build knows no URLs; those of the store.
    pub fn open(path: &Path, access: Access) -> Result<Self> {
        let Some(url) = ObjectUrl::of(path)? else { return Ok(Self { path: path.to_owned(), shown: None }) };
        let shown = Mirrored::open(&url, access, CACHE_DIR.get().map(PathBuf::as_path))?;
        Ok(Self { path: shown.path().to_owned(), shown: Some(shown) })
    }

    /// Where it is on disk.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Brings what was written to the bucket, if it belongs there and is not there yet.
    ///
    /// # Errors
    /// On errors of the store, or if something else has written to the bucket meanwhile.
    pub fn finish(self) -> Result<()> {
        self.shown.map_or(Ok(()), |shown| shown.finish())
    }
}
