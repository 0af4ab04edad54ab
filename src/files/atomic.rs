//! Files that are either whole or absent: how does a killed or failed write leave no damaged file under its final name?

use super::written::{enter, sync_folder};
use fs_err as fs;
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The ending of unfinished files and folders, which are leftovers once their writer is gone.
pub const PARTIAL_SUFFIX: &str = ".partial";

/// Hexadecimal digits between the name and the ending.
const N_DIGITS: usize = 16;

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
}

/// A file written beside its place, under a name that no other writer has, and renamed when whole. Dropping it without
/// [`commit`](Self::commit) removes it. It is entered in the list of written files of a folder above it, if one keeps a
/// list.
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
    /// Begins to write `path`, whose folder must exist.
    pub fn create(path: &Path) -> io::Result<Self> {
        enter(path)?;
        let partial = unique_partial(path);
        let file = fs::File::options().write(true).create_new(true).open(&partial)?;
        let file = BufWriter::with_capacity(1 << 20, file);
        Ok(Self { file: Some(file), path: path.to_owned(), partial, hasher: blake3::Hasher::new(), n_bytes: 0 })
    }

    /// The final path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Size and hash of the bytes written so far.
    pub fn stamp(&self) -> FileStamp {
        FileStamp { n_bytes: self.n_bytes, checksum: self.hasher.finalize().to_hex().to_string() }
    }

    /// Brings the content to the disk and the file to its final name.
    ///
    /// # Errors
    /// On I/O errors; nothing is then under the final name that was not before.
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
        sync_folder(self.path.parent().unwrap_or(Path::new("")))?;
        Ok(self.stamp())
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
/// Errors of `write`, and I/O errors; nothing new is then under `path`.
pub fn write_atomically<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut AtomicFile) -> std::result::Result<(), E>,
) -> std::result::Result<FileStamp, E> {
    let mut file = AtomicFile::create(path)?;
    write(&mut file)?;
    Ok(file.commit()?)
}

/// Gives the file at `from` a second name, or copies it if the file system has no links. Only the whole file ever
/// appears under `to`.
///
/// # Errors
/// On I/O errors; nothing new is then under `to`.
pub fn link_or_copy(from: &Path, to: &Path) -> io::Result<()> {
    enter(to)?;
    if fs::hard_link(from, to).is_ok() {
        sync_folder(to.parent().unwrap_or(Path::new("")))?;
        return Ok(());
    }
    let mut from = fs::File::open(from)?;
    write_atomically(to, |file| io::copy(&mut from, file).map(drop)).map(drop)
}

/// Removes a file if it is there.
///
/// # Errors
/// On I/O errors other than a missing file.
pub fn remove_if_present(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// A name beside `path` for an unfinished file or folder: `<name>.<16 hexadecimal digits>.partial`. The digits are
/// drawn anew each time, so that no two writers share a name, on any machines.
pub fn unique_partial(path: &Path) -> PathBuf {
    // The standard library draws the keys of a hasher from the system's randomness.
    let digits = RandomState::new().build_hasher().finish();
    let mut name = path.file_name().map_or_else(OsString::new, OsString::from);
    name.push(format!(".{digits:0N_DIGITS$x}{PARTIAL_SUFFIX}"));
    path.with_file_name(name)
}

/// Whether `name` is one that [`unique_partial`] gives to a file called `whole`.
pub fn is_partial_of(name: &str, whole: &str) -> bool {
    let digits = (|| name.strip_prefix(whole)?.strip_prefix('.')?.strip_suffix(PARTIAL_SUFFIX))();
    digits.is_some_and(|digits| digits.len() == N_DIGITS && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Removes a useless file. A failure only leaves a leftover.
fn discard(partial: &Path) {
    drop(fs::remove_file(partial));
}
