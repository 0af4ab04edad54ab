//! Mirrors of folders, which are notified of changes.
//!
//! A folder can be the view of one that is kept elsewhere and seen by other machines. Code that writes and reads it
//! need not know: the folder's [`Mirror`] is notified of each file that has its final name here.

use std::borrow::Cow;
use std::fmt::Debug;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Keeps a folder and its other place in agreement. Its errors are those of the other place.
pub trait Mirror: Debug + Send + Sync {
    /// A file has its final name and is whole.
    fn committed(&self, path: &Path) -> io::Result<()>;
    /// A file was removed.
    fn removed(&self, path: &Path) -> io::Result<()>;
    /// Shows in the folder `dir` what others have written, as often as is reasonable.
    fn refresh(&self, dir: &Path) -> io::Result<()>;
    /// The length of a file of others whose content is not shown here, bytes.
    fn n_bytes_elsewhere(&self, path: &Path) -> Option<u64>;
    /// Makes the other place equal to the whole present folder, which must not contain anything half done.
    ///
    /// # Errors
    /// When another program has written there; errors of the other place.
    fn publish(&self) -> io::Result<()>;
}

/// A folder with its mirror, or with just another name for people.
struct Mirrored {
    dir: PathBuf,
    name: String,
    mirror: Option<Arc<dyn Mirror>>,
}

/// Folders are few, and are looked up once for each file.
static MIRRORED: RwLock<Vec<Mirrored>> = RwLock::new(Vec::new());

/// From now on, `mirror` is notified of changes below `dir`, and messages call it `name`.
pub fn mirror(dir: &Path, name: String, mirror: Arc<dyn Mirror>) {
    list_mut().push(Mirrored { dir: dir.to_owned(), name, mirror: Some(mirror) });
}

/// From now on, messages call the folder or file `dir` by the name `name`.
pub fn call(dir: &Path, name: String) {
    list_mut().push(Mirrored { dir: dir.to_owned(), name, mirror: None });
}

/// Ends the effect of [`mirror`]. Later messages still find the name.
pub fn unmirror(dir: &Path) {
    list_mut().iter_mut().filter(|mirrored| mirrored.dir == dir).for_each(|mirrored| mirrored.mirror = None);
}

/// The mirror of the folder above `path` that has one.
pub fn mirror_above(path: &Path) -> Option<Arc<dyn Mirror>> {
    list().iter().find(|mirrored| path.starts_with(&mirrored.dir))?.mirror.clone()
}

/// Notifies the mirror of the folder, if it has one, that a file has its final name. An
/// [`AtomicFile`](super::AtomicFile) does so by itself.
pub fn tell_committed(path: &Path) -> io::Result<()> {
    mirror_above(path).map_or(Ok(()), |mirror| mirror.committed(path))
}

/// Notifies the mirror of the folder, if it has one, that a file was removed.
pub(super) fn tell_removed(path: &Path) -> io::Result<()> {
    mirror_above(path).map_or(Ok(()), |mirror| mirror.removed(path))
}

/// The name for people of a file or folder that is shown from elsewhere, such as its URL; `None` for all others.
pub fn name_elsewhere(path: &Path) -> Option<String> {
    list().iter().find_map(|Mirrored { dir, name, .. }| {
        let below = path.strip_prefix(dir).ok()?.to_string_lossy();
        Some(if below.is_empty() { name.clone() } else { format!("{name}/{below}") })
    })
}

/// A message with the names of places instead of the paths where they are shown.
pub fn in_their_names(message: &str) -> Cow<'_, str> {
    list().iter().fold(Cow::Borrowed(message), |message, Mirrored { dir, name, .. }| {
        let dir = dir.to_string_lossy();
        if message.contains(dir.as_ref()) { Cow::Owned(message.replace(dir.as_ref(), name)) } else { message }
    })
}

fn list() -> RwLockReadGuard<'static, Vec<Mirrored>> {
    MIRRORED.read().unwrap_or_else(PoisonError::into_inner)
}

fn list_mut() -> RwLockWriteGuard<'static, Vec<Mirrored>> {
    MIRRORED.write().unwrap_or_else(PoisonError::into_inner)
}
