//! Object stores in a build without them: no instance can exist.

use super::ObjectUrl;
use super::error::{Error, Result};
use std::path::{Path, PathBuf};

/// A URL to which results are copied.
#[derive(Debug)]
pub(super) enum Target {}

impl Target {
    pub(super) fn at(url: ObjectUrl) -> Result<Self> {
        Err(Error::NotBuilt { url })
    }

    pub(super) fn work_folder(&self) -> Result<PathBuf> {
        match *self {}
    }

    pub(super) fn copy_from(&self, _: &Path) -> Result<(ObjectUrl, usize)> {
        match *self {}
    }
}

/// Recordings in an object store.
#[derive(Debug)]
pub enum Recordings {}

impl Recordings {
    /// The recordings at a URL; `None` for a path on disk.
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
