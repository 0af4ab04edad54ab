//! Names for people of files that are copies: messages call a download by its URL.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{PoisonError, RwLock};

/// Copies are few, and are looked up once for each message.
static NAMES: RwLock<Vec<(PathBuf, String)>> = RwLock::new(Vec::new());

/// From now on, messages call the folder or file `path` by the name `name`.
pub fn call(path: &Path, name: String) {
    NAMES.write().unwrap_or_else(PoisonError::into_inner).push((path.to_owned(), name));
}

/// A message with the names of copies instead of their paths.
pub fn in_their_names(message: &str) -> Cow<'_, str> {
    let names = NAMES.read().unwrap_or_else(PoisonError::into_inner);
    names.iter().fold(Cow::Borrowed(message), |message, (path, name)| {
        let path = path.to_string_lossy();
        if message.contains(path.as_ref()) { Cow::Owned(message.replace(path.as_ref(), name)) } else { message }
    })
}
