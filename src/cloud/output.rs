//! The folder that a run works in, and the place that its results are copied to if the user named a URL.

use super::ObjectUrl;
#[cfg(feature = "cloud")]
use super::copy::Target;
use super::error::Result;
#[cfg(not(feature = "cloud"))]
use super::no_stores::Target;
use crate::files::Error;
use std::path::{Path, PathBuf};

/// See the module.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    target: Option<Target>,
}

impl Output {
    /// A folder on disk as it is; for a URL, a folder of the cache, which is the same each time. `inputs` are read
    /// meanwhile, by name.
    ///
    /// # Errors
    /// When the URL is invalid, overlaps an input, or holds objects that djinn did not write; in builds without object
    /// stores; errors of the store.
    pub fn open<'a>(path: &Path, inputs: impl Iterator<Item = (String, &'a Path)>) -> Result<Self> {
        let Some(url) = ObjectUrl::of(path)? else { return Ok(Self { path: path.to_owned(), target: None }) };
        for (name, input) in inputs {
            if let Some(relation) = ObjectUrl::of(input)?.and_then(|input| url.relation_to(&input)) {
                let (output, input) = (path.to_owned(), input.to_owned());
                return Err(Error::Overlap { output, relation, name, input }.into());
            }
        }
        let target = Target::at(url)?;
        Ok(Self { path: target.work_folder()?, target: Some(target) })
    }

    /// The folder on disk.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Copies the results to the URL, if there is one. Returns it with the number of files that had to be copied.
    ///
    /// # Errors
    /// As [`Output::open`]. The store then holds no record or manifest of what is not whole there, the results stay
    /// whole on disk, and the next copy continues.
    pub fn copy(&self) -> Result<Option<(ObjectUrl, usize)>> {
        self.target.as_ref().map(|target| target.copy_from(&self.path)).transpose()
    }
}
