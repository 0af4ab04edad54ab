//! Folders that appear whole or not at all, even if others want the same name.

use super::atomic::{is_partial_of, unique_partial};
use super::error::{Error, Result};
use super::lock::Lock;
use super::overlap::check_overlap;
use super::written::{LIST_FILE, is_link, keep_list, listed, remove_listed, sync_folder};
use fs_err as fs;
use std::io;
use std::path::{Path, PathBuf};

/// A folder that is written beside its place, under a name of its own, and renamed when it is whole. It keeps a list of
/// the files written into it. Dropping it without [`commit`](Self::commit) removes the listed files.
#[derive(Debug)]
pub struct NewFolder {
    out: PathBuf,
    partial: PathBuf,
    is_committed: bool,
    // Released last.
    _lock: Lock,
}

impl NewFolder {
    /// Begins to write `out`, which must not exist or be empty. `inputs` are the paths of the inputs, each with its
    /// description. The remains of killed attempts are removed.
    ///
    /// # Errors
    /// [`Error::Overlap`], [`Error::Exists`], [`Error::IsFile`], [`Error::Link`], [`Error::Busy`]; errors of the file
    /// system.
    pub fn begin<'a>(out: &Path, inputs: impl IntoIterator<Item = (&'a str, &'a Path)>) -> Result<Self> {
        check_overlap(out, inputs)?;
        if out.file_name().is_none() {
            return Err(Error::Unnamed { path: out.to_owned() });
        }
        check_free(out)?;
        if let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            fs::create_dir_all(parent)?;
        }
        let lock = Lock::beside(out)?;
        // A previous holder of the lock may have been faster.
        check_free(out)?;
        remove_leftovers(out)?;
        let partial = unique_partial(out);
        fs::create_dir(&partial)?;
        let folder = Self { out: out.to_owned(), partial, is_committed: false, _lock: lock };
        keep_list(&folder.partial)?;
        Ok(folder)
    }

    /// The folder to write into.
    pub fn path(&self) -> &Path {
        &self.partial
    }

    /// Gives the folder its name.
    ///
    /// # Errors
    /// [`Error::Exists`] when another program put something there meanwhile; errors of the file system.
    pub fn commit(mut self) -> Result<()> {
        check_free(&self.out)?;
        if self.out.exists() {
            fs::remove_dir(&self.out)?;
        }
        fs::rename(&self.partial, &self.out)?;
        self.is_committed = true;
        fs::remove_file(self.out.join(LIST_FILE))?;
        sync_folder(&self.out)?;
        Ok(sync_folder(self.out.parent().unwrap_or(Path::new("")))?)
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if !self.is_committed {
            // A file that cannot be removed is a leftover, which the next attempt removes.
            drop(remove_all_listed(&self.partial));
        }
    }
}

/// Refuses a place that is not free for a new folder: an empty folder is.
///
/// # Errors
/// [`Error::Exists`], [`Error::IsFile`], [`Error::Link`]; errors of the file system.
pub fn check_free(out: &Path) -> Result<()> {
    if is_link(out) {
        return Err(Error::Link { path: out.to_owned() });
    }
    if out.is_file() {
        return Err(Error::IsFile { path: out.to_owned() });
    }
    let is_free = match fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => true,
        Err(error) => return Err(error.into()),
    };
    if is_free { Ok(()) } else { Err(Error::Exists { path: out.to_owned() }) }
}

/// Removes the listed remains of killed attempts beside `out`. The lock on `out` must be held.
fn remove_leftovers(out: &Path) -> Result<()> {
    let (Some(parent), Some(name)) = (out.parent(), out.file_name().and_then(|name| name.to_str())) else {
        return Ok(());
    };
    let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() && is_partial_of(&entry.file_name().to_string_lossy(), name) {
            remove_all_listed(&entry.path())?;
        }
    }
    Ok(())
}

fn remove_all_listed(dir: &Path) -> Result<()> {
    if let Some(ours) = listed(dir)? {
        remove_listed(dir, &ours)?;
    }
    Ok(())
}
