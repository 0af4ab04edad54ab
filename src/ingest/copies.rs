//! Which files of the inputs have the same bytes as others, whatever they are called?

use super::files::{file_name, is_archive};
use crate::files::files_below;
use std::collections::BTreeMap;
use std::io::{self, BufRead};
use std::path::{Path, PathBuf};

/// Tables of few bytes may well be alike: they hold a header, or an agent.
const LEAST_BYTES: u64 = 1024;

/// Copies among the files of the inputs on disk, archives included, each with its original: of files with the same
/// bytes the one with the shortest name, and the first of these.
///
/// Only files of the same size are compared. What cannot be read is none: reading it will say so.
pub(super) fn copies_among(inputs: &[PathBuf], is_recording: &dyn Fn(&str) -> bool) -> BTreeMap<PathBuf, PathBuf> {
    let mut by_size: BTreeMap<u64, Vec<PathBuf>> = BTreeMap::new();
    let is_read = |path: &Path| {
        let name = path.to_string_lossy();
        is_archive(&name) || is_recording(name.strip_suffix(".gz").unwrap_or(&name))
    };
    for path in inputs.iter().flat_map(|input| files_of(input)).filter(|path| is_read(path)) {
        let size = fs_err::metadata(&path).ok().filter(|file| file.is_file() && file.len() >= LEAST_BYTES);
        if let Some(size) = size {
            by_size.entry(size.len()).or_default().push(path);
        }
    }
    let mut copies = BTreeMap::new();
    for mut alike in by_size.into_values() {
        alike.sort_by_key(|path| file_name(&path.to_string_lossy()).len());
        let mut originals: Vec<PathBuf> = Vec::new();
        for path in alike {
            match originals.iter().find(|original| have_same_bytes(original, &path).unwrap_or(false)) {
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

fn have_same_bytes(a: &Path, b: &Path) -> io::Result<bool> {
    let open = |path| fs_err::File::open(path).map(io::BufReader::new);
    let (mut a, mut b) = (open(a)?, open(b)?);
    loop {
        let (left, right) = (a.fill_buf()?, b.fill_buf()?);
        let n = left.len().min(right.len());
        if left[..n] != right[..n] || (n == 0 && left.len() != right.len()) {
            return Ok(false);
        }
        if n == 0 {
            return Ok(true);
        }
        a.consume(n);
        b.consume(n);
    }
}
