//! How does a folder come into being whole or not at all?

use super::{Error, Result};
use crate::store::{CorpusTable, PARTIAL_SUFFIX};
use fs_err as fs;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

/// A folder that is written beside its place, under its name with `.partial`, and renamed when it is whole. Dropping it
/// without [`commit`](Self::commit) removes what was written.
pub(super) struct OutFolder {
    out: PathBuf,
    partial: PathBuf,
    is_committed: bool,
}

impl OutFolder {
    /// Begins to write `out`, which must not exist or be empty. What a killed tool left beside it is removed.
    pub(super) fn begin(out: &Path) -> Result<Self> {
        if !is_absent_or_empty(out)? {
            return Err(Error::OutputExists { dir: out.to_owned() });
        }
        let Some(name) = out.file_name() else {
            return Err(Error::Usage(format!("{} cannot name a new folder", out.display())));
        };
        let mut name = OsString::from(name);
        name.push(PARTIAL_SUFFIX);
        let partial = out.with_file_name(name);
        remove_leftover(&partial)?;
        fs::create_dir_all(&partial)?;
        Ok(Self { out: out.to_owned(), partial, is_committed: false })
    }

    /// Where to write.
    pub(super) fn path(&self) -> &Path {
        &self.partial
    }

    /// Gives the folder its name.
    pub(super) fn commit(mut self) -> Result<()> {
        if self.out.exists() {
            fs::remove_dir(&self.out)?;
        }
        fs::rename(&self.partial, &self.out)?;
        self.is_committed = true;
        Ok(())
    }
}

impl Drop for OutFolder {
    fn drop(&mut self) {
        if !self.is_committed {
            // A leftover has no manifest or is not under its name, and the next attempt removes it.
            drop(fs::remove_dir_all(&self.partial));
        }
    }
}

fn is_absent_or_empty(dir: &Path) -> Result<bool> {
    if dir.is_file() {
        return Ok(false);
    }
    match fs::read_dir(dir) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(true),
        Err(error) => Err(error.into()),
    }
}

/// Removes what a killed tool left, and nothing that somebody else put there.
fn remove_leftover(partial: &Path) -> Result<()> {
    if !partial.exists() {
        return Ok(());
    }
    for entry in fs::read_dir(partial)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        let is_ours = ["manifest.json", "README.md"].iter().any(|own| name.starts_with(own))
            || CorpusTable::ALL.into_iter().any(|table| name.split('.').next() == Some(table.name()));
        if !is_ours {
            return Err(Error::ForeignLeftover { dir: partial.to_owned(), found: name });
        }
    }
    Ok(fs::remove_dir_all(partial)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_appears_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let (out, partial) = (dir.path().join("out"), dir.path().join("out.partial"));
        let folder = OutFolder::begin(&out).unwrap();
        fs::write(folder.path().join("lanes.parquet"), "half").unwrap();
        assert!(!out.exists());
        drop(folder);
        assert!(!out.exists() && !partial.exists());

        // A killed tool left its folder: the next attempt takes its place.
        fs::create_dir(&partial).unwrap();
        fs::write(partial.join("lanes.parquet.partial"), "half").unwrap();
        let folder = OutFolder::begin(&out).unwrap();
        fs::write(folder.path().join("manifest.json"), "whole").unwrap();
        folder.commit().unwrap();
        assert_eq!(fs::read_to_string(out.join("manifest.json")).unwrap(), "whole");
        assert!(!partial.exists() && !out.join("lanes.parquet.partial").exists());
        assert!(matches!(OutFolder::begin(&out).err(), Some(Error::OutputExists { .. })));
    }

    #[test]
    fn folders_of_others_are_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let partial = dir.path().join("out.partial");
        fs::create_dir(&partial).unwrap();
        fs::write(partial.join("thesis.doc"), "years of work").unwrap();
        let error = OutFolder::begin(&dir.path().join("out")).err().unwrap().to_string();
        assert!(error.contains("thesis.doc") && partial.join("thesis.doc").exists(), "{error}");
    }
}
