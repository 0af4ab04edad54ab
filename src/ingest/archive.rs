//! Placeholder.

use std::path::PathBuf;

/// A file within a folder or archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Path inside the container, with `/` between parts.
    pub path: String,
    /// The folder, archive or file that was given as input.
    pub container: PathBuf,
    /// Uncompressed size in bytes, where the container tells.
    pub size: Option<u64>,
}
