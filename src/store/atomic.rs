//! Files that are either whole or absent: how does a killed or failed write leave no damaged file under its final name?

use super::{Error, Result};
use fs_err as fs;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::ffi::OsString;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The ending of files that are being written; such files are leftovers once their writer is gone.
pub const PARTIAL_SUFFIX: &str = ".partial";

/// Size and content hash of a written file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileStamp {
    /// Length of the file, bytes.
    pub n_bytes: u64,
    /// BLAKE3 hash of the content, hexadecimal.
    pub checksum: String,
}

impl FileStamp {
    /// The stamp of these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self { n_bytes: bytes.len() as u64, checksum: blake3::hash(bytes).to_hex().to_string() }
    }

    /// Checks that `bytes`, the content of `path`, are those that were stamped.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the length or the hash differ.
    pub fn verify(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        self.verify_length(path, bytes.len() as u64)?;
        self.verify_checksum(path, blake3::hash(bytes))
    }

    /// Checks that the file at `path` holds the bytes that were stamped, reading it in pieces.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the length or the hash differ; those of the file system.
    pub fn verify_file(&self, path: &Path) -> Result<()> {
        let file = fs::File::open(path)?;
        self.verify_length(path, file.metadata()?.len())?;
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(file)?;
        self.verify_checksum(path, hasher.finalize())
    }

    fn verify_checksum(&self, path: &Path, found: blake3::Hash) -> Result<()> {
        if found.to_hex().as_str() == self.checksum {
            Ok(())
        } else {
            Err(Error::corrupt(path, "its checksum is not the one it was written with"))
        }
    }

    /// Checks the length alone, which costs nothing and finds truncation.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the length differs.
    pub fn verify_length(&self, path: &Path, n_bytes: u64) -> Result<()> {
        if n_bytes == self.n_bytes {
            Ok(())
        } else {
            Err(Error::corrupt(path, format!("it has {n_bytes} bytes where {} were written", self.n_bytes)))
        }
    }
}

/// A file written beside its place and renamed when whole. Dropping it without [`commit`](Self::commit) removes it.
#[derive(Debug)]
pub struct AtomicFile {
    /// `None` once committed.
    file: Option<BufWriter<fs::File>>,
    path: PathBuf,
    partial: PathBuf,
    hasher: blake3::Hasher,
    n_bytes: u64,
}

impl AtomicFile {
    /// Begins to write `path`, whose folder must exist. A leftover of an earlier attempt is overwritten.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn create(path: &Path) -> io::Result<Self> {
        let partial = partial_path(path);
        let file = BufWriter::with_capacity(1 << 20, fs::File::create(&partial)?);
        Ok(Self { file: Some(file), path: path.to_owned(), partial, hasher: blake3::Hasher::new(), n_bytes: 0 })
    }

    /// The final path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes written so far.
    pub const fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    /// Brings the content to the disk and the file to its final name.
    ///
    /// # Errors
    /// Whatever the file system says; nothing is then under the final name that was not before.
    pub fn commit(mut self) -> io::Result<FileStamp> {
        let Some(mut file) = self.file.take() else {
            return Err(io::Error::other("the file is committed already"));
        };
        let renamed = (|| {
            file.flush()?;
            file.get_ref().sync_all()?;
            drop(file);
            fs::rename(&self.partial, &self.path)
        })();
        if let Err(error) = renamed {
            discard(&self.partial);
            return Err(error);
        }
        sync_folder_of(&self.path)?;
        Ok(FileStamp { n_bytes: self.n_bytes, checksum: self.hasher.finalize().to_hex().to_string() })
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(file) = &mut self.file else {
            return Err(io::Error::other("the file is committed already"));
        };
        let n_written = file.write(bytes)?;
        self.hasher.update(&bytes[..n_written]);
        self.n_bytes += n_written as u64;
        Ok(n_written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if self.file.take().is_some() {
            discard(&self.partial);
        }
    }
}

/// Writes a whole file through `write`.
///
/// # Errors
/// Those of `write` and of the file system; nothing new is then under `path`.
pub fn write_atomically<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut AtomicFile) -> std::result::Result<(), E>,
) -> std::result::Result<FileStamp, E> {
    let mut file = AtomicFile::create(path)?;
    write(&mut file)?;
    Ok(file.commit()?)
}

/// Writes `value` as indented JSON with a final newline.
///
/// # Errors
/// Those of JSON and of the file system.
pub fn write_json_atomically<T: Serialize + ?Sized>(path: &Path, value: &T) -> Result<FileStamp> {
    let mut text = serde_json::to_vec_pretty(value).map_err(Error::json(path))?;
    text.push(b'\n');
    write_atomically(path, |file| Ok(file.write_all(&text)?))
}

/// Reads a JSON file.
///
/// # Errors
/// Those of JSON and of the file system; both name the path.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&fs::read(path)?).map_err(Error::json(path))
}

/// Removes the leftovers of killed writers directly in `dir`, and says how many there were.
///
/// # Errors
/// Whatever the file system says.
pub fn remove_partials(dir: &Path) -> io::Result<usize> {
    let mut n_removed = 0;
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().ends_with(PARTIAL_SUFFIX) && entry.file_type()?.is_file() {
            fs::remove_file(entry.path())?;
            n_removed += 1;
        }
    }
    Ok(n_removed)
}

/// Removes a file if it is there.
///
/// # Errors
/// Whatever the file system says, except that the file is missing.
pub fn remove_if_present(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

fn partial_path(path: &Path) -> PathBuf {
    let mut name = path.file_name().map_or_else(OsString::new, OsString::from);
    name.push(PARTIAL_SUFFIX);
    path.with_file_name(name)
}

/// Removes a file that is of no use to anybody. A failure only leaves a leftover, which resuming removes.
fn discard(partial: &Path) {
    drop(fs::remove_file(partial));
}

/// A rename is on the disk only once its folder is.
#[cfg(unix)]
fn sync_folder_of(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(dir) if !dir.as_os_str().is_empty() => fs::File::open(dir)?.sync_all(),
        _ => fs::File::open(".")?.sync_all(),
    }
}

/// Folders cannot be opened here; the system orders renames by itself.
#[cfg(not(unix))]
fn sync_folder_of(_path: &Path) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(stamp.verify(&path, b"onetw").unwrap_err().to_string().contains("5 bytes where 6"));
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
    fn leftovers_of_killed_writers_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("scenes-00000.arrow.partial"), "half").unwrap();
        fs::write(dir.path().join("scenes-00000.json"), "{}").unwrap();
        assert_eq!(remove_partials(dir.path()).unwrap(), 1);
        assert!(dir.path().join("scenes-00000.json").exists());
    }

    #[test]
    fn errors_name_the_path() {
        let dir = tempfile::tempdir().unwrap();
        let error = AtomicFile::create(&dir.path().join("missing/a.txt")).unwrap_err();
        assert!(error.to_string().contains("a.txt.partial"), "{error}");
    }
}
