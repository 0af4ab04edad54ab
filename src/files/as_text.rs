//! Paths as text, for JSON, TOML, the shell and the like.
//!
//! A path need not be UTF-8. Invalid parts are replaced, so that a record of the path can be written; nothing is looked
//! up by such a text.

use serde::{Serialize, Serializer};
use std::path::{Path, PathBuf};

/// Writes a path.
pub fn path_as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    path.to_string_lossy().serialize(serializer)
}

/// Writes paths.
pub fn paths_as_text<S: Serializer>(paths: &[PathBuf], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(paths.iter().map(|path| path.to_string_lossy()))
}

/// A word quoted for the shell; unchanged if it has no special characters.
pub fn for_shell(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+%@".contains(c);
    match !word.is_empty() && word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}
