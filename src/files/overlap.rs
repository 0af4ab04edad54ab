//! Does an output overlap an input, whatever links and dots the paths are written with?

use super::error::{Error, PathRelation, Result};
use std::ffi::OsString;
use std::io;
use std::path::{Component, Path, PathBuf};

/// The most links that are followed before a path is considered a loop; Linux has the same limit.
const MAX_LINKS: usize = 40;

/// Refuses an output that is an input, lies inside one, or contains one. Neither needs to exist yet.
///
/// # Errors
/// [`Error::Overlap`] for the first input that overlaps; errors of the file system.
pub fn check_overlap<'a>(output: &Path, inputs: impl IntoIterator<Item = (&'a str, &'a Path)>) -> Result<()> {
    let resolved = resolve(output)?;
    for (name, input) in inputs {
        if let Some(relation) = relation(&resolved, &resolve(input)?) {
            let (output, input) = (output.to_owned(), input.to_owned());
            return Err(Error::Overlap { output, relation, name: name.to_owned(), input });
        }
    }
    Ok(())
}

fn relation(output: &Path, input: &Path) -> Option<PathRelation> {
    match (output.starts_with(input), input.starts_with(output)) {
        (true, true) => Some(PathRelation::Same),
        (true, false) => Some(PathRelation::Inside),
        (false, true) => Some(PathRelation::Contains),
        (false, false) => None,
    }
}

/// The target of a path: absolute, without links and dots. Unlike [`std::fs::canonicalize`] it does not require any
/// part of the path to exist: a missing part is not a link.
///
/// # Errors
/// When links form a loop, or there is no current folder.
pub fn resolve(path: &Path) -> io::Result<PathBuf> {
    let gone = |error: io::Error| {
        io::Error::new(error.kind(), format!("the folder that {} is relative to is gone: {error}", path.display()))
    };
    let mut at = if path.is_absolute() { PathBuf::new() } else { std::env::current_dir().map_err(gone)? };
    let mut pending: Vec<PathPart> = parts(path);
    let mut n_links = 0;
    while let Some(part) = pending.pop() {
        match part {
            PathPart::Root(root) => at = root,
            PathPart::Up => _ = at.pop(),
            PathPart::Name(name) => {
                at.push(name);
                let Ok(target) = fs_err::read_link(&at) else { continue };
                n_links += 1;
                if n_links > MAX_LINKS {
                    return Err(io::Error::other(format!("{}: its symbolic links form a loop", path.display())));
                }
                at.pop();
                pending.extend(parts(&target));
            }
        }
    }
    Ok(at)
}

enum PathPart {
    Root(PathBuf),
    Up,
    Name(OsString),
}

/// The parts of a path, the last one first.
fn parts(path: &Path) -> Vec<PathPart> {
    let mut parts = Vec::new();
    for component in path.components() {
        match component {
            Component::RootDir => parts.push(PathPart::Root(component.as_os_str().into())),
            // Prefixes are those of drives, which Unix does not have.
            Component::CurDir | Component::Prefix(_) => {}
            Component::ParentDir => parts.push(PathPart::Up),
            Component::Normal(name) => parts.push(PathPart::Name(name.to_owned())),
        }
    }
    parts.reverse();
    parts
}
