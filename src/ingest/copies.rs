//! Which files of the inputs have the content of others, whatever they are called?
//!
//! Line ends, and blank lines at the end, are no content: editors and version control change them.

use super::files::{file_name, is_archive};
use crate::files::files_below;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Tables of few bytes may well be alike: they hold a header, or an agent.
const LEAST_BYTES: u64 = 1024;
/// So much of both ends of a file decides whether it is compared with another, bytes without line ends.
const COMPARED_BYTES: usize = 512;

/// Copies among the files of the inputs on disk, archives included, each with its original: of files with the same
/// content the one with the shortest name, and the first of these.
///
/// Only files that begin and end alike are compared. What cannot be read is none: reading it will say so.
pub(super) fn copies_among(inputs: &[PathBuf], is_recording: &dyn Fn(&str) -> bool) -> BTreeMap<PathBuf, PathBuf> {
    let mut by_ends: BTreeMap<u64, Vec<PathBuf>> = BTreeMap::new();
    let is_read = |path: &Path| {
        let name = path.to_string_lossy();
        is_archive(&name) || is_recording(name.strip_suffix(".gz").unwrap_or(&name))
    };
    for path in inputs.iter().flat_map(|input| files_of(input)).filter(|path| is_read(path)) {
        let size = fs_err::metadata(&path).ok().filter(|file| file.is_file() && file.len() >= LEAST_BYTES);
        if let Some(hash) = size.and_then(|size| hash_of_ends(&path, size.len()).ok()) {
            by_ends.entry(hash).or_default().push(path);
        }
    }
    let mut copies = BTreeMap::new();
    for mut alike in by_ends.into_values() {
        alike.sort_by_key(|path| file_name(&path.to_string_lossy()).len());
        let mut originals: Vec<PathBuf> = Vec::new();
        for path in alike {
            match originals.iter().find(|original| have_same_content(original, &path).unwrap_or(false)) {
                Some(original) => _ = copies.insert(path, original.clone()),
                None => originals.push(path),
            }
        }
    }
    copies
}

/// The files below an input, or the input itself.
fn files_of(input: &Path) -> Vec<PathBuf> {
    match input.is_dir() {
        true => files_below(input).unwrap_or_default().iter().map(|name| input.join(name)).collect(),
        false => vec![input.to_owned()],
    }
}

/// A hash of the beginning and the end of a file of this size.
fn hash_of_ends(path: &Path, size: u64) -> io::Result<u64> {
    // Enough if every other byte is of a line end.
    let n_read = 2 * COMPARED_BYTES as u64;
    let mut file = fs_err::File::open(path)?;
    let mut ends = [Vec::new(), Vec::new()];
    for (end, from) in ends.iter_mut().zip([0, size.saturating_sub(n_read)]) {
        file.seek(SeekFrom::Start(from))?;
        (&mut file).take(n_read).read_to_end(end)?;
        end.retain(|byte| !matches!(byte, b'\r' | b'\n'));
    }
    let [begin, end] = &ends;
    let mut hasher = DefaultHasher::new();
    begin[..begin.len().min(COMPARED_BYTES)].hash(&mut hasher);
    end[end.len().saturating_sub(COMPARED_BYTES)..].hash(&mut hasher);
    Ok(hasher.finish())
}

fn have_same_content(a: &Path, b: &Path) -> io::Result<bool> {
    let bytes = |path: &Path| {
        let file = io::BufReader::new(fs_err::File::open(path)?);
        Ok::<_, io::Error>(file.bytes().filter(|byte| !matches!(byte, Ok(b'\r'))))
    };
    let (mut a, mut b) = (bytes(a)?, bytes(b)?);
    loop {
        match (a.next().transpose()?, b.next().transpose()?) {
            (None, None) => return Ok(true),
            (left, right) if left == right => {}
            // Blank lines at the end, unless more follows.
            (Some(b'\n'), None) | (None, Some(b'\n')) => {}
            _ => return Ok(false),
        }
    }
}
