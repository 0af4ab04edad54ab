//! Errors of commands that may not write to a place, and what the user can do about them.

use std::fmt;
use std::io;
use std::path::PathBuf;

/// A refusal to write.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// The file system refused; the message names the path.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// An output that overlaps an input.
    #[error(
        "cannot write {}: it {relation} the input {name} ({}); nothing was changed; choose another output, or move the \
         input",
        .output.display(),
        .input.display()
    )]
    Overlap { output: PathBuf, relation: PathRelation, name: String, input: PathBuf },
    /// A place with files that no list of ours names.
    #[error(
        "cannot write {}: it holds {}, which djinn did not write; nothing was changed; move that away, or choose \
         another output",
        .path.display(),
        few(.found)
    )]
    Foreign { path: PathBuf, found: Vec<PathBuf> },
    /// A symbolic link in the place of an output.
    #[error(
        "cannot write {}: it is a symbolic link, which djinn did not create; nothing was changed; remove the link, or \
         choose another output",
        .path.display()
    )]
    Link { path: PathBuf },
    /// A list of ours with entries that djinn cannot have written.
    #[error(
        "{} is damaged: {detail}; nothing was changed; move the folder {} away, and run the same command again",
        .path.display(),
        .path.parent().unwrap_or(.path).display()
    )]
    Damaged { path: PathBuf, detail: String },
    /// A place to which another process writes.
    #[error("{} is in use by {holder}; wait for it, or choose another output", .path.display())]
    Busy { path: PathBuf, holder: String },
    /// A folder that must be new.
    #[error("{} exists and is not empty; choose a new folder", .path.display())]
    Exists { path: PathBuf },
    /// A file in place of a folder.
    #[error("{} is a file; choose a new folder", .path.display())]
    IsFile { path: PathBuf },
    /// A path without a name at its end, such as `..`.
    #[error("{} cannot name a new folder", .path.display())]
    Unnamed { path: PathBuf },
}

/// The relation of an output to an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathRelation {
    /// They are the same file or folder.
    Same,
    /// The output lies inside the input.
    Inside,
    /// The output contains the input.
    Contains,
}

impl fmt::Display for PathRelation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Same => "is",
            Self::Inside => "lies inside",
            Self::Contains => "contains",
        })
    }
}

/// The first few names, and the number of others.
fn few(found: &[PathBuf]) -> String {
    const SHOWN: usize = 3;
    let names: Vec<String> = found.iter().take(SHOWN).map(|path| path.display().to_string()).collect();
    let more = found.len().saturating_sub(SHOWN);
    if more == 0 { names.join(", ") } else { format!("{} and {more} more", names.join(", ")) }
}

/// The results of this module.
pub type Result<T, E = Error> = std::result::Result<T, E>;
