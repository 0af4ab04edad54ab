//! Is this file, folder or configuration the same as last time, without reading terabytes each time?

use crate::files::regular;
use anyhow::{Context, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// For files up to twice this size, `hash` covers everything; for larger ones, the size and this much from each end.
const SAMPLED_BYTES: u64 = 1 << 20;

/// The content of a file or folder. Equal contents give equal fingerprints on every machine, wherever they are.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PathFingerprint {
    /// Total size, bytes.
    pub n_bytes: u64,
    /// Number of files: 1 for a file.
    pub n_files: u64,
    /// Hash, 32 hexadecimal digits; for large files, of their ends only.
    pub hash: String,
    /// Hash of the whole content where `hash` is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub whole: Option<String>,
    /// Hash of the sizes and times of the files when `whole` was taken, or of the tags of objects: `whole` holds until
    /// these change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub times: Option<String>,
}

impl PathFingerprint {
    /// Whether both are fingerprints of the same content, as far as both are known.
    pub(super) fn agrees_with(&self, other: &Self) -> bool {
        let of_ends = |one: &Self| (one.n_bytes, one.n_files, one.hash.clone());
        let wholes = self.whole.as_ref().zip(other.whole.as_ref());
        of_ends(self) == of_ends(other) && wholes.is_none_or(|(one, other)| one == other)
    }

    /// The hash that distinguishes contents.
    pub(super) fn identity(&self) -> &str {
        self.whole.as_deref().unwrap_or(&self.hash)
    }
}

/// The fingerprint of a file, or of all files below a folder with their names, with the whole content of large ones. An
/// entry of a folder that cannot be opened counts by its name: its reader will report why.
pub fn fingerprint_path(path: &Path) -> Result<PathFingerprint> {
    fingerprint_to(path, None, None)
}

/// The fingerprint of a file, or of the files in a folder that are named relative to it (`None`: all). Named files have
/// the fingerprint of the whole folder if it holds nothing else. While large files have the age and size that they had
/// when `known` was taken, `known` still holds, and their middles are not read.
pub(super) fn fingerprint_to(
    path: &Path,
    names: Option<&[PathBuf]>,
    known: Option<&PathFingerprint>,
) -> Result<PathFingerprint> {
    let (root, mut files) = match (regular(path)?.is_dir(), names) {
        (false, _) => (None, vec![path.to_owned()]),
        (true, Some(names)) => (Some(path), names.iter().map(|name| path.join(name)).collect()),
        (true, None) => {
            let mut files = Vec::new();
            list_files(path, &mut files)?;
            (Some(path), files)
        }
    };
    files.sort();
    let is_own = names.is_some();
    let mut found = combined(root, &files, Reading::Ends, is_own)?;
    let is_large = |file: &PathBuf| fs_err::metadata(file).is_ok_and(|metadata| metadata.len() > 2 * SAMPLED_BYTES);
    if files.iter().any(is_large) {
        let times = combined(root, &files, Reading::Times, is_own)?.hash;
        let known = known.filter(|known| found.agrees_with(known) && known.times.as_ref() == Some(&times));
        found.whole = match known.and_then(|known| known.whole.clone()) {
            Some(whole) => Some(whole),
            None => Some(combined(root, &files, Reading::Whole, is_own)?.hash),
        };
        found.times = Some(times);
    }
    Ok(found)
}

/// The part of a file that is hashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reading {
    Ends,
    Whole,
    Times,
}

/// The hash of one file, or of the files below `root` with their names. Files of our own that exist must be readable.
fn combined(root: Option<&Path>, files: &[PathBuf], reading: Reading, are_own: bool) -> Result<PathFingerprint> {
    let of = |file: &PathBuf| match (fs_err::File::open(file), root) {
        (Ok(file), _) => hash_file(file, reading),
        (Err(error), None) => Err(error.into()),
        (Err(error), Some(_)) if are_own && error.kind() != ErrorKind::NotFound => Err(error.into()),
        (Err(_), Some(_)) => Ok((0, blake3::hash(b"unopened"))),
    };
    let hashes: Vec<(u64, blake3::Hash)> = files.par_iter().map(of).collect::<Result<_>>()?;
    let n_bytes = hashes.iter().map(|(n_bytes, _)| n_bytes).sum();
    let hash = match (root, hashes.as_slice()) {
        (None, [(_, hash)]) => *hash,
        _ => {
            let mut hasher = blake3::Hasher::new();
            for (file, (_, hash)) in files.iter().zip(&hashes) {
                let name = root.map_or(Ok(file.as_path()), |root| file.strip_prefix(root));
                let name = name.context("a folder lists only what lies below it")?.to_string_lossy();
                hasher.update(&(name.len() as u64).to_le_bytes());
                hasher.update(name.as_bytes());
                hasher.update(hash.as_bytes());
            }
            hasher.finalize()
        }
    };
    Ok(PathFingerprint { n_bytes, n_files: files.len() as u64, hash: short_hex(&hash), whole: None, times: None })
}

/// The fingerprint of a value: of its JSON, in which struct fields keep their order and maps are sorted.
pub fn fingerprint_value(value: &impl Serialize) -> Result<String> {
    Ok(short_hex(&blake3::hash(&serde_json::to_vec(value)?)))
}

fn short_hex(hash: &blake3::Hash) -> String {
    hash.to_hex()[..32].to_owned()
}

fn list_files(folder: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    for entry in fs_err::read_dir(folder)? {
        let entry = entry?;
        // A link to a folder counts by its target's name alone: following it could lead into a loop.
        if entry.file_type()?.is_dir() {
            list_files(&entry.path(), files)?;
        } else if fs_err::metadata(entry.path()).map_or(true, |metadata| metadata.is_file()) {
            files.push(entry.path());
        }
    }
    Ok(())
}

fn hash_file(mut file: fs_err::File, reading: Reading) -> Result<(u64, blake3::Hash)> {
    let metadata = file.metadata()?;
    let n_bytes = metadata.len();
    let mut hasher = blake3::Hasher::new();
    hasher.update(&n_bytes.to_le_bytes());
    match reading {
        Reading::Times => {
            let since = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
            hasher.update(&since.as_nanos().to_le_bytes());
        }
        Reading::Ends if n_bytes > 2 * SAMPLED_BYTES => {
            hasher.update_reader((&mut file).take(SAMPLED_BYTES))?;
            file.seek(SeekFrom::End(-(SAMPLED_BYTES as i64)))?;
            hasher.update_reader(&mut file)?;
        }
        Reading::Ends | Reading::Whole => _ = hasher.update_reader(&mut file)?,
    }
    Ok((n_bytes, hasher.finalize()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fingerprint_sees_contents_and_names_but_not_places() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [("a/x.csv", "1"), ("b/x.csv", "1"), ("c/x.csv", "2"), ("d/y.csv", "1")] {
            let path = folder.path().join(name);
            fs_err::create_dir_all(path.parent().unwrap()).unwrap();
            fs_err::write(path, text).unwrap();
        }
        let of = |name: &str| fingerprint_path(&folder.path().join(name)).unwrap();
        assert_eq!(of("a"), of("b"));
        assert_ne!(of("a").hash, of("c").hash);
        assert_ne!(of("a").hash, of("d").hash);
        assert_eq!((of("a/x.csv").n_bytes, of("a/x.csv").n_files), (1, 1));
        assert_eq!(of("a/x.csv"), of("d/y.csv"), "a file's own name is not its content");
    }

    #[cfg(unix)]
    #[test]
    fn what_cannot_be_opened_counts_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        fs_err::write(folder.path().join("x.csv"), "1").unwrap();
        let of = || fingerprint_path(folder.path()).unwrap();
        let without = of();
        std::os::unix::fs::symlink("nowhere", folder.path().join("y.csv")).unwrap();
        let dangling = of();
        assert_ne!(without.hash, dangling.hash);
        fs_err::write(folder.path().join("nowhere"), "2").unwrap();
        assert_ne!(of().hash, dangling.hash);
    }

    #[test]
    fn the_middle_of_a_large_file_counts_and_is_read_again_only_when_the_file_is_another() {
        let folder = tempfile::tempdir().unwrap();
        let (path, mut bytes) = (folder.path().join("large"), vec![0; 3 << 20]);
        fs_err::write(&path, &bytes).unwrap();
        let before = fingerprint_path(folder.path()).unwrap();
        assert!(before.whole.is_some() && before.agrees_with(&before));
        let modified = fs_err::metadata(&path).unwrap().modified().unwrap();
        bytes[3 << 19] = 1;
        fs_err::write(&path, &bytes).unwrap();
        let after = fingerprint_path(folder.path()).unwrap();
        assert!(after.hash == before.hash && !after.agrees_with(&before) && after.identity() != before.identity());
        let again = fingerprint_to(folder.path(), None, Some(&before)).unwrap();
        assert_eq!(again, after, "it was written since");
        fs_err::OpenOptions::new().write(true).open(&path).unwrap().file().set_modified(modified).unwrap();
        let known = fingerprint_to(folder.path(), None, Some(&before)).unwrap();
        assert_eq!(known, before, "size and time are those of before: not read");
    }

    #[test]
    fn both_ends_of_a_large_file_count() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large");
        let mut bytes = vec![0; 3 << 20];
        let mut seen = std::collections::BTreeSet::new();
        for changed in [None, Some(0), Some((3 << 20) - 1)] {
            if let Some(at) = changed {
                bytes[at] = 1;
            }
            fs_err::write(&path, &bytes).unwrap();
            seen.insert(fingerprint_path(&path).unwrap().hash);
        }
        bytes.push(0);
        fs_err::write(&path, &bytes).unwrap();
        seen.insert(fingerprint_path(&path).unwrap().hash);
        assert_eq!(seen.len(), 4);
    }
}
