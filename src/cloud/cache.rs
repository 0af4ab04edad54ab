//! The cache of downloaded objects.
//!
//! The folder of the cache holds `objects/`, each under a hash of its URL and its tag, so that an object that changes
//! gets another name; `inputs/`, recordings under their names in the bucket; `views/`, the folders that commands work
//! in; and `locks/`. All of it can be removed while no djinn runs.

use super::ObjectUrl;
use super::bucket::{Bucket, Object};
use super::connect::endpoint;
use super::error::{Error, Result};
use crate::files::{LIST_FILE, unique_partial};
use fs_err as fs;
use std::io;
use std::path::{Path, PathBuf};

/// The variable that names the folder.
const VARIABLE: &str = "DJINN_CACHE_DIR";

/// The cache.
#[derive(Debug, Clone)]
pub(super) struct Cache {
    dir: PathBuf,
}

/// Whether a file may share its content with the cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    /// It is only replaced as a whole.
    Shared,
    /// A command may write into it.
    Own,
}

impl Cache {
    /// The cache in this folder.
    pub(super) fn in_dir(dir: PathBuf) -> Self {
        Self { dir }
    }

    /// The `chosen` folder, the one named by the environment, or otherwise `djinn` in the user's cache folder.
    pub(super) fn of_process(chosen: Option<&Path>) -> Result<Self> {
        let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let by_user =
            || set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache"))).map(|dir| dir.join("djinn"));
        let dir = chosen.map(Path::to_owned).or_else(|| set(VARIABLE)).or_else(by_user).ok_or(Error::NoCache)?;
        Ok(Self::in_dir(std::path::absolute(dir)?))
    }

    /// A folder of the cache, which is created if it is missing.
    pub(super) fn folder(&self, name: &str) -> Result<PathBuf> {
        let dir = self.dir.join(name);
        fs::create_dir_all(&dir)?;
        Ok(dir)
    }

    /// Puts an object into the file `to`, downloading it unless it is cached. Returns the object, which may have been
    /// replaced since it was listed.
    pub(super) fn bring(&self, bucket: &Bucket, object: &Object, to: &Path, content: Content) -> Result<Object> {
        let mut object = object.clone();
        let mut here = self.place(bucket, &object);
        if !fs::metadata(&here).is_ok_and(|metadata| metadata.len() == object.n_bytes) {
            fs::create_dir_all(here.parent().unwrap_or(&self.dir))?;
            let found = bucket.download(&object, &here)?;
            let place = self.place(bucket, &found);
            if place != here {
                fs::create_dir_all(place.parent().unwrap_or(&self.dir))?;
                fs::rename(&here, &place)?;
                here = place;
            }
            object = found;
            // The same time on every machine that downloads it.
            fs::File::open(&here)?.file().set_modified(object.modified)?;
        }
        fs::create_dir_all(to.parent().unwrap_or(&self.dir))?;
        put(&here, to, content)?;
        Ok(object)
    }

    /// Keeps the content of a file that was just uploaded.
    pub(super) fn keep(&self, bucket: &Bucket, object: &Object, from: &Path) -> Result<()> {
        let here = self.place(bucket, object);
        if !here.exists() {
            fs::create_dir_all(here.parent().unwrap_or(&self.dir))?;
            put(from, &here, Content::Shared)?;
        }
        Ok(())
    }

    fn place(&self, bucket: &Bucket, object: &Object) -> PathBuf {
        let hash = name_of(&bucket.url().join(&object.name), &object.etag);
        self.dir.join("objects").join(&hash[..2]).join(hash)
    }
}

/// Whether files with this name may be written into after they were downloaded: logs and lists grow.
pub(super) fn content_of(name: &str) -> Content {
    let grows = [".txt", ".jsonl", LIST_FILE].iter().any(|ending| name.ends_with(ending));
    if grows { Content::Own } else { Content::Shared }
}

/// 32 hexadecimal digits for the present content of a URL, distinct from the same URL of another store.
pub(super) fn name_of(url: &ObjectUrl, tag: &str) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in [endpoint(url), url.to_string(), tag.to_owned()] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex()[..32].to_owned()
}

/// Replaces a file by another, at once and without notifying any mirror.
fn put(from: &Path, to: &Path, content: Content) -> io::Result<()> {
    let partial = unique_partial(to);
    if content == Content::Own || fs::hard_link(from, &partial).is_err() {
        fs::copy(from, &partial)?;
        let modified = fs::metadata(from)?.modified()?;
        fs::File::options().write(true).open(&partial)?.file().set_modified(modified)?;
    }
    let put = fs::rename(&partial, to);
    // Two names of one file are not renamed over each other, nor is a failed copy.
    match fs::remove_file(&partial) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => put,
    }
}
