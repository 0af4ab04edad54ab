//! Reads the files of a `.zip` archive.

use super::{BUFFER_BYTES, Entry, Packed, Unopened, Visitor, clean_name, damaged, is_hidden, open};
use crate::ingest::Error;
use std::io;
use std::ops::ControlFlow;
use std::path::Path;

/// Visits the files of a zip archive in the order of its central directory. A damaged file does not affect the others.
pub(super) fn visit(
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
    visit: &mut Visitor<'_>,
) -> Result<ControlFlow<()>, Error> {
    let mut archive = zip::ZipArchive::new(open(path)?).map_err(|error| damaged(path, None, &to_io(error)))?;
    let names: Vec<String> = archive.file_names_raw().map(|name| String::from_utf8_lossy(name).into_owned()).collect();
    for (index, raw_name) in names.iter().enumerate() {
        let name = clean_name(raw_name);
        if raw_name.ends_with(['/', '\\']) || is_hidden(&name) || !wanted(&name) {
            continue;
        }
        let entry = |size| Entry { path: name.clone(), container: path.to_owned(), size };
        let flow = match archive.by_index(index) {
            Ok(file) if file.is_symlink() => continue,
            Ok(file) => {
                let entry = entry(Some(file.size()));
                visit(&entry, &mut io::BufReader::with_capacity(BUFFER_BYTES, Packed(file)))?
            }
            Err(error) => visit(&entry(None), &mut Unopened::because(to_io(error)))?,
        };
        if flow.is_break() {
            return Ok(flow);
        }
    }
    Ok(ControlFlow::Continue(()))
}

fn to_io(error: zip::result::ZipError) -> io::Error {
    match error {
        zip::result::ZipError::Io(error) => error,
        other => io::Error::new(io::ErrorKind::InvalidData, other),
    }
}
