//! Lists the files in a folder and the folders below it, in order of their names.

use super::{Entry, Unopened, Visitor, clean_name, is_hidden, visit_file};
use crate::ingest::Error;
use std::ffi::OsString;
use std::io;
use std::ops::ControlFlow;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Visits the files of `root` and of the folders below it; archives among them are entered.
pub(super) fn visit(
    root: &Path,
    wanted: &dyn Fn(&str) -> bool,
    visit: &mut Visitor<'_>,
) -> Result<ControlFlow<()>, Error> {
    visit_folder(root, &mut Vec::new(), &mut Vec::new(), wanted, visit)
}

/// `below` are the names from the root to this folder, `ancestors` the folders on the way as the file system numbers
/// them, by device and inode.
fn visit_folder(
    root: &Path,
    below: &mut Vec<OsString>,
    ancestors: &mut Vec<(u64, u64)>,
    wanted: &dyn Fn(&str) -> bool,
    visit: &mut Visitor<'_>,
) -> Result<ControlFlow<()>, Error> {
    let folder = below.iter().fold(root.to_owned(), |path, name| path.join(name));
    let metadata = fs_err::metadata(&folder)?;
    let number = (metadata.dev(), metadata.ino());
    // A link that leads back to a folder above it: what is there is visited there.
    if ancestors.contains(&number) {
        return Ok(ControlFlow::Continue(()));
    }
    ancestors.push(number);
    for name in sorted_names(&folder)? {
        let path = folder.join(&name);
        // A dangling link counts as a file; opening it fails when the file is needed.
        let is_folder = fs_err::metadata(&path).is_ok_and(|metadata| metadata.is_dir());
        below.push(name);
        let flow = if is_folder {
            visit_folder(root, below, ancestors, wanted, visit)?
        } else {
            let relative: Vec<_> = below.iter().map(|name| name.to_string_lossy()).collect();
            visit_file_or_pass(root, &relative.join("/"), &path, wanted, visit)?
        };
        below.pop();
        if flow.is_break() {
            return Ok(flow);
        }
    }
    ancestors.pop();
    Ok(ControlFlow::Continue(()))
}

/// Visits a file. An archive that breaks off before any wanted entry counts as an unreadable file, which may be wanted
/// by its name like any other: it may belong to something else.
fn visit_file_or_pass(
    root: &Path,
    name: &str,
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
    visit: &mut Visitor<'_>,
) -> Result<ControlFlow<()>, Error> {
    let mut is_untouched = true;
    let result = visit_file(root, name, path, wanted, &mut |entry, reader| {
        is_untouched = false;
        visit(entry, reader)
    });
    match result {
        Err(Error::Container { .. }) if is_untouched && !wanted(name) => Ok(ControlFlow::Continue(())),
        Err(Error::Container { detail, .. }) if is_untouched => {
            let entry = Entry { path: clean_name(name), container: root.to_owned(), size: None };
            visit(&entry, &mut Unopened::because(io::Error::other(detail)))
        }
        result => result,
    }
}

fn sorted_names(folder: &Path) -> io::Result<Vec<OsString>> {
    let mut names = fs_err::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.file_name()))
        .collect::<io::Result<Vec<OsString>>>()?;
    names.retain(|name| !is_hidden(&name.to_string_lossy()));
    names.sort_unstable();
    Ok(names)
}
