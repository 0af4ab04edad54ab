//! The folder of this machine for what is in object stores: `inputs/` holds downloads, `outputs/` the folders of runs
//! whose results are copied to a store. All of it can be removed while no djinn runs.

#[cfg(feature = "cloud")]
use super::connect::endpoint;
#[cfg(feature = "cloud")]
use super::{Error, ObjectUrl, Result};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

static CHOSEN: OnceLock<PathBuf> = OnceLock::new();

/// Chooses the folder in this process; the first choice counts.
pub fn use_cache_dir(dir: &Path) {
    let _ = CHOSEN.set(dir.to_owned());
}

/// The place below `part` of the folder for the content of a URL, distinct from the same URL of another store and from
/// other content (`tag`). It ends with the names of the URL, which tell the split of recordings.
#[cfg(feature = "cloud")]
pub(super) fn place_of(part: &str, url: &ObjectUrl, tag: &str) -> Result<PathBuf> {
    let hash = hash_of([endpoint(url).as_str(), &url.to_string(), tag].into_iter());
    Ok(cache_dir()?.join(part).join(hash).join(&url.bucket).join(&url.key))
}

/// 32 hexadecimal digits for a list of texts.
#[cfg(feature = "cloud")]
pub(super) fn hash_of<'a>(parts: impl Iterator<Item = &'a str>) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex()[..32].to_owned()
}

/// The chosen folder, the one named by the environment, or otherwise `djinn` in the user's cache folder.
#[cfg(feature = "cloud")]
fn cache_dir() -> Result<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let by_user = || set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache"))).map(|dir| dir.join("djinn"));
    let dir = CHOSEN.get().cloned().or_else(|| set("DJINN_CACHE_DIR")).or_else(by_user).ok_or(Error::NoCache)?;
    Ok(std::path::absolute(dir)?)
}
