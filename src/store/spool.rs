//! Values in a temporary file, which are known before the rows that precede them in a table.
//!
//! A value is four bytes of length and its `postcard` encoding. Unlike a Parquet file, whose footer describes every row
//! group, a spool takes the same memory however long it becomes.

use super::{Error, Result, remove_if_present};
use crate::files::AtomicFile;
use fs_err as fs;
use serde::{Serialize, de::DeserializeOwned};
use std::io::{BufReader, Read, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

/// A spool that is being written.
pub struct Spool<T> {
    file: AtomicFile,
    values: PhantomData<T>,
}

impl<T: Serialize> Spool<T> {
    /// Begins the file.
    pub fn create(path: &Path) -> Result<Self> {
        Ok(Self { file: AtomicFile::create(path)?, values: PhantomData })
    }

    /// Adds a value.
    ///
    /// # Errors
    /// On I/O errors, or if the value has a sequence of unknown length, or 4 GiB.
    pub fn push(&mut self, value: &T) -> Result<()> {
        let bytes = postcard::to_stdvec(value).map_err(std::io::Error::other)?;
        let length = u32::try_from(bytes.len()).map_err(std::io::Error::other)?;
        self.file.write_all(&length.to_le_bytes())?;
        Ok(self.file.write_all(&bytes)?)
    }

    /// Ends the file, so that it can be read.
    pub fn finish(self) -> Result<Spooled<T>> {
        let path = self.file.path().to_owned();
        let n_bytes = self.file.commit()?.n_bytes;
        Ok(Spooled { path, n_bytes, values: PhantomData })
    }
}

/// A finished spool.
#[derive(Debug)]
pub struct Spooled<T> {
    path: PathBuf,
    n_bytes: u64,
    values: PhantomData<T>,
}

impl<T: DeserializeOwned> Spooled<T> {
    /// The values, in the order in which they were added; they end after the first error. They can be read more than
    /// once.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the file is not as it was written; errors of the file system.
    pub fn values(&self) -> Result<impl Iterator<Item = Result<T>> + use<T>> {
        let mut file = BufReader::new(fs::File::open(&self.path)?);
        let (path, mut n_left) = (self.path.clone(), self.n_bytes);
        Ok(std::iter::from_fn(move || {
            if n_left == 0 {
                return None;
            }
            let value = next_value(&path, &mut file, &mut n_left);
            if value.is_err() {
                n_left = 0;
            }
            Some(value)
        }))
    }
}

impl<T> Spooled<T> {
    /// The error for an invalid value of this file.
    pub(crate) fn corrupt(&self, detail: &str) -> Error {
        Error::corrupt(&self.path, detail)
    }

    /// Removes the file.
    pub fn remove(self) -> Result<()> {
        Ok(remove_if_present(&self.path)?)
    }
}

/// The next value of a file with `n_left` bytes that are not read yet.
fn next_value<T: DeserializeOwned>(path: &Path, file: &mut impl Read, n_left: &mut u64) -> Result<T> {
    let unreadable = |error: std::io::Error| Error::unreadable(path, format!("it cannot be read: {error}"));
    let mut length = [0; 4];
    file.read_exact(&mut length).map_err(unreadable)?;
    let length = u32::from_le_bytes(length);
    // A damaged length must not allocate more than the file has.
    let rest = n_left.checked_sub(4 + u64::from(length));
    *n_left = rest.ok_or_else(|| Error::corrupt(path, "it ends within a value"))?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).map_err(unreadable)?;
    postcard::from_bytes(&bytes).map_err(|error| Error::corrupt(path, format!("it cannot be decoded: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(n: u64) -> (String, Vec<Option<f64>>) {
        (format!("scene-{n}"), vec![Some(0.1 * n as f64), None, Some(f64::MIN_POSITIVE / 3.0)])
    }

    #[test]
    fn a_spool_gives_back_its_values_in_order_and_leaves_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.spool");
        let mut spool = Spool::create(&path).unwrap();
        (0..500).try_for_each(|n| spool.push(&value(n))).unwrap();
        let spooled = spool.finish().unwrap();
        for _ in 0..2 {
            let read: Vec<_> = spooled.values().unwrap().collect::<Result<_>>().unwrap();
            assert_eq!(read, (0..500).map(value).collect::<Vec<_>>());
        }
        spooled.remove().unwrap();
        assert!(!path.exists());
        let none = Spool::<u64>::create(&path).unwrap().finish().unwrap();
        assert_eq!(none.values().unwrap().count(), 0);
    }

    #[test]
    fn a_damaged_spool_ends_with_one_error_that_names_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.spool");
        let mut spool = Spool::create(&path).unwrap();
        (0..3).try_for_each(|n| spool.push(&value(n))).unwrap();
        let spooled = spool.finish().unwrap();
        let whole = fs::read(&path).unwrap();
        let mut longer = whole.clone();
        longer[3] = 0xff;
        for damaged in [&longer[..], &whole[..whole.len() - 1], &[]] {
            fs::write(&path, damaged).unwrap();
            let read: Vec<Result<(String, Vec<Option<f64>>)>> = spooled.values().unwrap().collect();
            let errors: Vec<String> = read.iter().filter_map(|value| Some(value.as_ref().err()?.to_string())).collect();
            assert!(errors.len() == 1 && errors[0].contains("a.spool") && read.last().unwrap().is_err(), "{errors:?}");
        }
    }
}
