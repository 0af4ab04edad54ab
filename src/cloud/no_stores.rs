//! Object stores in a build without them: no instance can exist.

use super::error::{Error, Result};
use super::{Access, ObjectUrl};
use std::path::{Path, PathBuf};

/// A folder of objects, shown on disk.
#[derive(Debug)]
pub(super) enum Mirrored {}

impl Mirrored {
    pub(super) fn open(url: &ObjectUrl, _: Access, _: Option<&Path>) -> Result<Self> {
        Err(Error::NotBuilt { url: url.clone() })
    }

    pub(super) fn path(&self) -> &Path {
        match *self {}
    }

    pub(super) fn finish(&self) -> Result<()> {
        match *self {}
    }
}

/// Recordings in an object store.
#[derive(Debug)]
pub enum Recordings {}

impl Recordings {
    /// The recordings at a URL; `None` for a path on disk.
    ///
    /// # Errors
    /// For every URL.
    pub fn at(path: &Path) -> Result<Option<Self>> {
        ObjectUrl::of(path)?.map_or(Ok(None), |url| Err(Error::NotBuilt { url }))
    }

    /// A tag that changes with them.
    pub fn tag(&self) -> String {
        match *self {}
    }

    /// Their paths on disk.
    pub fn on_disk(&self) -> Result<PathBuf> {
        match *self {}
    }
}
