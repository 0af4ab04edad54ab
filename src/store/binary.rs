//! Values that only this program reads: exact to the bit, and checked.
//!
//! A file begins with a line that names its format with a version and the BLAKE3 hash of the rest: the value, as
//! `postcard` encodes it.

use super::{Error, Result};
use crate::files::{FileStamp, write_atomically};
use serde::{Serialize, de::DeserializeOwned};
use std::io::Write;
use std::path::Path;

/// Writes `value` in the format with this name, such as `figures.v1`.
///
/// # Errors
/// On I/O errors, or if `value` has a sequence of unknown length.
pub fn write_binary_atomically<T: Serialize>(path: &Path, format: &str, value: &T) -> Result<FileStamp> {
    let bytes = postcard::to_stdvec(value).map_err(std::io::Error::other)?;
    let head = format!("{format} {}\n", blake3::hash(&bytes).to_hex());
    write_atomically(path, |file| {
        file.write_all(head.as_bytes())?;
        Ok(file.write_all(&bytes)?)
    })
}

/// Reads a file written by [`write_binary_atomically`].
///
/// # Errors
/// [`Error::SchemaVersion`] when the file has another format, [`Error::Corrupt`] when its content is not as it was
/// written; errors of the file system.
pub fn read_binary<T: DeserializeOwned>(path: &Path, format: &str) -> Result<T> {
    let content = fs_err::read(path)?;
    let end = content.iter().position(|byte| *byte == b'\n').unwrap_or(content.len());
    let (head, rest) = content.split_at(end);
    let head = String::from_utf8_lossy(head);
    let (found, checksum) = head.split_once(' ').unwrap_or_default();
    if found != format {
        let found = found.chars().take(40).collect();
        return Err(Error::SchemaVersion { path: path.to_owned(), expected: format.to_owned(), found });
    }
    let bytes = rest.get(1..).unwrap_or_default();
    if blake3::hash(bytes).to_hex().as_str() != checksum {
        return Err(Error::corrupt(path, "its checksum is not the one it was written with"));
    }
    postcard::from_bytes(bytes).map_err(|error| Error::corrupt(path, format!("it cannot be decoded: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_a_number_survives() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        let values = [0.1, -0.0, f64::MIN_POSITIVE / 3.0, f64::INFINITY, f64::from_bits(0x7ff8_0000_0000_0123)];
        let written = (values.map(Some).to_vec(), None::<f64>, u64::MAX);
        write_binary_atomically(&path, "numbers.v1", &written).unwrap();
        let read: (Vec<Option<f64>>, Option<f64>, u64) = read_binary(&path, "numbers.v1").unwrap();
        let bits = |values: &[Option<f64>]| values.iter().map(|value| value.unwrap().to_bits()).collect::<Vec<_>>();
        assert_eq!((bits(&read.0), read.1, read.2), (bits(&written.0), None, u64::MAX));
    }

    #[test]
    fn damaged_and_foreign_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        write_binary_atomically(&path, "numbers.v1", &vec![1.5, 2.5]).unwrap();
        let whole = fs_err::read(&path).unwrap();
        let said = |bytes: &[u8], format: &str| {
            fs_err::write(&path, bytes).unwrap();
            read_binary::<Vec<f64>>(&path, format).map_err(|error| error.to_string())
        };
        assert_eq!(said(&whole, "numbers.v1").unwrap(), [1.5, 2.5]);
        assert!(said(&whole, "numbers.v2").unwrap_err().contains("has schema `numbers.v1`, expected `numbers.v2`"));
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            assert!(said(&damaged, "numbers.v1").unwrap_err().contains("a.bin"), "byte {at}");
            assert!(said(&whole[..at], "numbers.v1").is_err(), "{at} bytes");
        }
    }
}
