//! Whole files: checks against their stamps, and JSON.

use super::{Error, Result};
use crate::files::{FileStamp, write_atomically};
use fs_err as fs;
use serde::{Serialize, de::DeserializeOwned};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

impl FileStamp {
    /// Checks that `bytes`, the content of `path`, match the stamp.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the length or the hash differ.
    pub fn verify(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        self.verify_length(path, bytes.len() as u64)?;
        self.verify_checksum(path, blake3::hash(bytes))
    }

    /// Checks that the file at `path` matches the stamp, reading it in pieces.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the length or the hash differ; errors of the file system.
    pub fn verify_file(&self, path: &Path) -> Result<()> {
        let file = fs::File::open(path)?;
        self.verify_length(path, file.metadata()?.len())?;
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(file)?;
        self.verify_checksum(path, hasher.finalize())
    }

    /// Whether the file at `path` matches the stamp.
    ///
    /// # Errors
    /// On I/O errors other than a missing file.
    pub fn is_of(&self, path: &Path) -> Result<bool> {
        match self.verify_file(path) {
            Ok(()) => Ok(true),
            Err(Error::Io(error)) if !is_missing(&error) => Err(error.into()),
            Err(_) => Ok(false),
        }
    }

    fn verify_checksum(&self, path: &Path, found: blake3::Hash) -> Result<()> {
        if found.to_hex().as_str() == self.checksum {
            Ok(())
        } else {
            Err(Error::corrupt(path, "its checksum is not the one it was written with"))
        }
    }

    /// Checks only the length, which costs nothing and finds truncation.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the length differs.
    pub fn verify_length(&self, path: &Path, n_bytes: u64) -> Result<()> {
        if n_bytes == self.n_bytes {
            Ok(())
        } else {
            Err(Error::corrupt(path, format!("it has {n_bytes} bytes, but {} were written", self.n_bytes)))
        }
    }
}

/// Writes `value` as indented JSON with a final newline.
pub fn write_json_atomically<T: Serialize + ?Sized>(path: &Path, value: &T) -> Result<FileStamp> {
    let mut text = serde_json::to_vec_pretty(value).map_err(Error::json(path))?;
    text.push(b'\n');
    write_atomically(path, |file| Ok(file.write_all(&text)?))
}

/// Reads a JSON file.
///
/// # Errors
/// If the file cannot be read or is not JSON of this form; the message names the path.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&fs::read(path)?).map_err(Error::json(path))
}

/// Reads a JSON file of unfinished work; `None` if it is missing or not whole.
pub fn read_if_whole<T: DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    match fs::read(path) {
        Err(error) if is_missing(&error) => Ok(None),
        bytes => Ok(serde_json::from_slice(&bytes?).ok()),
    }
}

/// Whether an error of reading means that there is no such file.
pub(super) fn is_missing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory)
}

/// Writes a record: an object as indented JSON, whose last entry is a checksum of everything before it.
pub fn write_record<T: Serialize>(path: &Path, value: &T) -> Result<FileStamp> {
    let text = serde_json::to_string_pretty(value).map_err(Error::json(path))?;
    let body = text.strip_suffix("\n}").unwrap_or(&text);
    write_atomically(path, |file| Ok(write!(file, "{body}{}", seal(body.as_bytes()))?))
}

/// Reads a record; `None` if there is none.
///
/// # Errors
/// [`Error::Record`] when it is not as it was written; errors of the file system.
pub fn read_record<T: DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    let bytes = match fs::read(path) {
        Err(error) if is_missing(&error) => return Ok(None),
        bytes => bytes?,
    };
    let damaged = |detail: String| Error::Record { path: path.to_owned(), detail };
    if !is_sealed(&bytes) {
        return Err(damaged("its checksum is not the one it was written with".to_owned()));
    }
    serde_json::from_slice(&bytes).map(Some).map_err(|error| damaged(error.to_string()))
}

/// The end of a record that begins with `body`.
fn seal(body: &[u8]) -> String {
    format!(",\n  \"checksum\": \"{}\"\n}}\n", blake3::hash(body).to_hex())
}

/// Whether the bytes are those of an unchanged record.
fn is_sealed(bytes: &[u8]) -> bool {
    let n_body = bytes.len().checked_sub(seal(b"").len());
    let parts = n_body.and_then(|n_body| bytes.split_at_checked(n_body));
    parts.is_some_and(|(body, end)| end == seal(body).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::AtomicFile;

    #[test]
    fn a_committed_file_is_whole_and_stamped() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        let stamp = write_atomically::<io::Error>(&path, |file| {
            file.write_all(b"one")?;
            assert!(!path.exists());
            file.write_all(b"two")
        })
        .unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"onetwo");
        assert_eq!(stamp, FileStamp::of(b"onetwo"));
        stamp.verify(&path, b"onetwo").unwrap();
        assert!(stamp.verify(&path, b"onetwO").unwrap_err().to_string().contains("checksum"));
        assert!(stamp.verify(&path, b"onetw").unwrap_err().to_string().contains("5 bytes, but 6"));
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_beside_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        fs::write(&path, "old").unwrap();
        let failed = write_atomically(&path, |file| {
            file.write_all(b"new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn every_flipped_bit_of_a_record_is_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("record.json");
        let value = serde_json::json!({ "stage": "mine", "list": [1, 2.5, null], "inner": { "a": "b" } });
        write_record(&path, &value).unwrap();
        let found: serde_json::Value = read_record(&path).unwrap().unwrap();
        assert_eq!((&found["list"], found["checksum"].as_str().unwrap().len()), (&value["list"], 64));
        let bytes = fs::read(&path).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, flipped).unwrap();
            let error = read_record::<serde_json::Value>(&path).unwrap_err();
            assert!(matches!(error, Error::Record { .. }), "bit {bit}: {error}");
        }
        for n_bytes in 0..bytes.len() {
            fs::write(&path, &bytes[..n_bytes]).unwrap();
            assert!(read_record::<serde_json::Value>(&path).is_err(), "{n_bytes} bytes");
        }
        assert!(read_record::<serde_json::Value>(&dir.path().join("none")).unwrap().is_none());
    }

    #[test]
    fn failures_of_the_system_are_no_damage() {
        let path = Path::new("a.parquet");
        let failed = Error::unreadable(path, "External: Too many open files (os error 24)");
        assert!(matches!(&failed, Error::Io(_)), "{failed}");
        assert!(failed.to_string().starts_with("failed to read a.parquet: "), "{failed}");
        assert!(matches!(Error::unreadable(path, "External: failed to fill whole buffer"), Error::Corrupt { .. }));
        let dir = tempfile::tempdir().unwrap();
        let stamp = FileStamp::of(b"one");
        assert!(!stamp.is_of(&dir.path().join("none")).unwrap());
        assert!(read_if_whole::<u8>(&dir.path().join("none")).unwrap().is_none());
        fs::write(dir.path().join("a"), "1x").unwrap();
        assert!(!stamp.is_of(&dir.path().join("a")).unwrap());
        assert!(read_if_whole::<u8>(&dir.path().join("a")).unwrap().is_none());
        assert!(read_if_whole::<u8>(dir.path()).is_err(), "no file, but there");
    }

    #[test]
    fn errors_name_the_path() {
        let dir = tempfile::tempdir().unwrap();
        let error = AtomicFile::create(&dir.path().join("missing/a.txt")).unwrap_err();
        assert!(error.to_string().contains("a.txt."), "{error}");
    }
}
