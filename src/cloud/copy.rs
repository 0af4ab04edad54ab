//! Copies the results of a run to an object store, so that no reader ever takes half of them for the whole.
//!
//! A run folder says what is whole: `manifest.json` in a folder, `<stage>.done.json` beside the outputs of a stage, and
//! `run.json`. So a copy removes those that will change, then replaces everything else, and writes them last, in this
//! order. Before, it lists in the object [`LIST`] what it is about to write: only listed objects are ever replaced or
//! removed, by this copy or the next. There are no locks in a store: one command at a time may write to a URL.

use super::ObjectUrl;
use super::bucket::Bucket;
use super::cache::place_of;
use super::error::{Error, Result};
use super::side_by_side::side_by_side;
use crate::files::{LOCK_FILE, Lock, PARTIAL_SUFFIX, files_below};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The object that lists the others: by name the BLAKE3 hash of each, or `null` from before it is written until all
/// are.
const LIST: &str = ".djinn-copied.json";

/// A URL to which results are copied.
#[derive(Debug)]
pub(super) struct Target {
    bucket: Bucket,
}

impl Target {
    pub(super) fn at(url: ObjectUrl) -> Result<Self> {
        let target = Self { bucket: Bucket::open(url)? };
        target.check_ours(&target.listed()?, &target.lengths()?)?;
        Ok(target)
    }

    /// The folder of this machine in which its results are made.
    pub(super) fn work_folder(&self) -> Result<PathBuf> {
        place_of("outputs", self.bucket.url(), "")
    }

    /// Copies the files of a folder; see the module.
    pub(super) fn copy_from(&self, folder: &Path) -> Result<(ObjectUrl, usize)> {
        let _lock = Lock::in_folder(folder)?;
        let files = files_of(folder)?;
        let (mut listed, there) = (self.listed()?, self.lengths()?);
        self.check_ours(&listed, &there)?;
        let is_there = |name: &String| {
            let (n_bytes, checksum) = &files[name];
            there.get(name) == Some(n_bytes) && listed.get(name).is_some_and(|listed| listed.as_ref() == Some(checksum))
        };
        let changed: Vec<&String> = files.keys().filter(|name| !is_there(name)).collect();
        let gone: Vec<&String> = there.keys().filter(|name| !files.contains_key(*name)).collect();
        if changed.is_empty() && gone.is_empty() {
            return Ok((self.bucket.url().clone(), 0));
        }
        listed.extend(changed.iter().map(|name| ((*name).clone(), None)));
        self.list(&listed)?;
        let replaced = changed.iter().filter(|name| Turn::of(name) != Turn::Outputs && there.contains_key(**name));
        let (last, rest): (Vec<&String>, _) = gone.iter().partition(|name| Turn::of(name) != Turn::Outputs);
        for names in [replaced.copied().chain(last).collect(), rest] {
            side_by_side(&names, &|name| self.bucket.remove(name))?;
        }
        for turn in [Turn::Outputs, Turn::Manifests, Turn::Records, Turn::Run] {
            let names: Vec<&String> = changed.iter().filter(|name| Turn::of(name) == turn).copied().collect();
            side_by_side(&names, &|name| self.bucket.upload(name, &folder.join(name)))?;
        }
        self.list(&files.iter().map(|(name, (_, checksum))| (name.clone(), Some(checksum.clone()))).collect())?;
        Ok((self.bucket.url().clone(), changed.len()))
    }

    /// The objects of ours.
    fn listed(&self) -> Result<BTreeMap<String, Option<String>>> {
        let Some(bytes) = self.bucket.read(LIST)? else { return Ok(BTreeMap::new()) };
        serde_json::from_slice(&bytes).map_err(|_| Error::Foreign { url: self.bucket.url().join(LIST) })
    }

    fn list(&self, listed: &BTreeMap<String, Option<String>>) -> Result<()> {
        let text = serde_json::to_vec_pretty(listed).map_err(std::io::Error::from)?;
        self.bucket.write(LIST, text)
    }

    /// The objects other than the list: their lengths, bytes.
    fn lengths(&self) -> Result<BTreeMap<String, u64>> {
        let objects = self.bucket.list()?;
        Ok(objects.into_iter().filter(|object| object.name != LIST).map(|it| (it.name, it.n_bytes)).collect())
    }

    /// Refuses to write beside objects that djinn did not write.
    fn check_ours(&self, listed: &BTreeMap<String, Option<String>>, there: &BTreeMap<String, u64>) -> Result<()> {
        match there.keys().find(|name| !listed.contains_key(*name)) {
            Some(name) => Err(Error::Foreign { url: self.bucket.url().join(name) }),
            None => Ok(()),
        }
    }
}

/// When a file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    Outputs,
    Manifests,
    Records,
    Run,
}

impl Turn {
    fn of(name: &str) -> Self {
        match name {
            "run.json" => Self::Run,
            _ if name.ends_with("/manifest.json") => Self::Manifests,
            _ if name.ends_with(".done.json") && !name.contains('/') => Self::Records,
            _ => Self::Outputs,
        }
    }
}

/// The finished files of a run folder by name, with length and hash; no locks and no unfinished work.
fn files_of(folder: &Path) -> Result<BTreeMap<String, (u64, String)>> {
    let is_finished = |name: &&PathBuf| {
        !name.iter().any(|part| {
            let part = part.to_string_lossy();
            part == LOCK_FILE || part.ends_with(PARTIAL_SUFFIX) || part.ends_with(".parts")
        })
    };
    let names: BTreeSet<PathBuf> = files_below(folder)?.into_iter().collect();
    let stamp = |name: &PathBuf| -> Result<_> {
        let mut hasher = blake3::Hasher::new();
        let n_bytes = std::io::copy(&mut fs_err::File::open(folder.join(name))?, &mut hasher)?;
        Ok((name.to_string_lossy().into_owned(), (n_bytes, hasher.finalize().to_hex().to_string())))
    };
    names.iter().filter(is_finished).map(stamp).collect()
}
