//! Is this file, folder or configuration the same as last time, without reading terabytes?

use anyhow::{Context, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Files up to twice this size are hashed whole; of larger ones, the size and this much from each end.
const SAMPLED_BYTES: u64 = 1 << 20;

/// What a file or folder held. Equal contents give equal fingerprints on every machine; times and places play no part.
///
/// The check is meant for accidents, not for adversaries: a large file that changed only in its middle and kept its size
/// is taken for the same.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PathFingerprint {
    /// Total size, bytes.
    pub n_bytes: u64,
    /// Number of files: 1 for a file.
    pub n_files: u64,
    /// Hash, 32 hexadecimal digits.
    pub hash: String,
}

/// The fingerprint of a file, or of all files below a folder with their names. What cannot be opened in a folder counts by its name:
/// whoever reads it says why.
pub fn fingerprint_path(path: &Path) -> Result<PathFingerprint> {
    if !fs_err::metadata(path)?.is_dir() {
        let (n_bytes, hash) = hash_file(fs_err::File::open(path)?)?;
        return Ok(PathFingerprint { n_bytes, n_files: 1, hash: short_hex(&hash) });
    }
    let mut files = Vec::new();
    list_files(path, &mut files)?;
    fingerprint_listed(path, files)
}

/// The fingerprint of a file, or of those files in a folder that are named relative to it, whatever else it holds: the same
/// as of the whole folder where that holds nothing else.
pub(super) fn fingerprint_files(path: &Path, names: &[PathBuf]) -> Result<PathFingerprint> {
    if !fs_err::metadata(path)?.is_dir() {
        return fingerprint_path(path);
    }
    fingerprint_listed(path, names.iter().map(|name| path.join(name)).collect())
}

fn fingerprint_listed(path: &Path, mut files: Vec<PathBuf>) -> Result<PathFingerprint> {
    files.sort();
    let hashes: Vec<(u64, blake3::Hash)> = (files.par_iter())
        .map(|file| fs_err::File::open(file).map_or_else(|_| Ok((0, blake3::hash(b"unopened"))), hash_file))
        .collect::<Result<_>>()?;
    let mut hasher = blake3::Hasher::new();
    for (file, (_, hash)) in files.iter().zip(&hashes) {
        let name = file.strip_prefix(path).context("a folder lists only what lies below it")?.to_string_lossy();
        hasher.update(&(name.len() as u64).to_le_bytes());
        hasher.update(name.as_bytes());
        hasher.update(hash.as_bytes());
    }
    Ok(PathFingerprint {
        n_bytes: hashes.iter().map(|(n_bytes, _)| n_bytes).sum(),
        n_files: files.len() as u64,
        hash: short_hex(&hasher.finalize()),
    })
}

/// The fingerprint of a value: of its JSON, in which struct fields keep their order and maps are sorted.
pub(super) fn fingerprint_value(value: &impl Serialize) -> Result<String> {
    Ok(short_hex(&blake3::hash(&serde_json::to_vec(value)?)))
}

fn short_hex(hash: &blake3::Hash) -> String {
    hash.to_hex()[..32].to_owned()
}

fn list_files(folder: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    for entry in fs_err::read_dir(folder)? {
        let entry = entry?;
        // A link to a folder counts by the file it names, if any: following it could go round in circles.
        if entry.file_type()?.is_dir() {
            list_files(&entry.path(), files)?;
        } else if fs_err::metadata(entry.path()).map_or(true, |metadata| metadata.is_file()) {
            files.push(entry.path());
        }
    }
    Ok(())
}

fn hash_file(mut file: fs_err::File) -> Result<(u64, blake3::Hash)> {
    let n_bytes = file.metadata()?.len();
    let mut hasher = blake3::Hasher::new();
    hasher.update(&n_bytes.to_le_bytes());
    if n_bytes <= 2 * SAMPLED_BYTES {
        hasher.update_reader(&mut file)?;
    } else {
        hasher.update_reader((&mut file).take(SAMPLED_BYTES))?;
        file.seek(SeekFrom::End(-(SAMPLED_BYTES as i64)))?;
        hasher.update_reader(&mut file)?;
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
