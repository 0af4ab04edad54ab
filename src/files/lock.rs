//! Locks on places to which a process writes.

use super::error::{Error, Result};
use fs_err::File;
use std::ffi::OsString;
use std::fs::TryLockError;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Name of the lock file in a folder.
pub const LOCK_FILE: &str = ".lock";

/// The time that a killed process may take to disappear.
const PATIENCE: Duration = Duration::from_secs(2);

/// The largest content of a lock file of ours: the number of a process.
const MAX_BYTES: u64 = 20;

/// The right to write to a place, until dropped. It is an advisory lock that the system takes back when the process
/// ends in any way; so there are no stale locks. The file holds the number of the process, for messages.
#[derive(Debug)]
pub struct Lock {
    file: File,
    /// The lock file, if it is removed with the lock.
    temporary: Option<PathBuf>,
    is_enforced: bool,
}

impl Lock {
    /// Takes the lock on the folder `dir`, which must exist. The lock file stays in it, empty.
    ///
    /// # Errors
    /// [`Error::Busy`] when another process has it; [`Error::Foreign`] when the lock file is not ours.
    pub fn in_folder(dir: &Path) -> Result<Self> {
        let path = dir.join(LOCK_FILE);
        let (file, is_enforced) = acquire(&path, dir)?;
        Ok(Self { file, temporary: None, is_enforced })
    }

    /// Whether the lock excludes others. Some network file systems have no locks; working without one is better than
    /// not at all, but users must know.
    pub const fn is_enforced(&self) -> bool {
        self.is_enforced
    }

    /// Takes the lock on `path`, which need not exist, by a file beside it that is removed with the lock.
    ///
    /// # Errors
    /// [`Error::Busy`] when another process has it; [`Error::Foreign`] when the lock file is not ours.
    pub fn beside(path: &Path) -> Result<Self> {
        let mut name = OsString::from(".");
        name.push(path.file_name().ok_or_else(|| Error::Unnamed { path: path.to_owned() })?);
        name.push(LOCK_FILE);
        // Messages name the folder that cannot be written, if that is the current one.
        let lock = std::path::absolute(path.with_file_name(name))?;
        loop {
            let (file, is_enforced) = acquire(&lock, path)?;
            // A previous holder of the lock may have removed the file after it was opened here.
            if is_still_at(&file, &lock) {
                return Ok(Self { file, temporary: Some(lock), is_enforced });
            }
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Failing to clear the number does no harm: the lock itself goes with the file handle.
        let _ = self.file.set_len(0);
        if let Some(path) = &self.temporary {
            let _ = fs_err::remove_file(path);
        }
    }
}

fn acquire(path: &Path, what: &Path) -> Result<(File, bool)> {
    let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
    let mut holder = String::new();
    let is_ours = file.metadata()?.len() <= MAX_BYTES
        && (&mut file).take(MAX_BYTES).read_to_string(&mut holder).is_ok()
        && holder.bytes().all(|byte| byte.is_ascii_digit());
    if !is_ours {
        return Err(Error::Foreign {
            path: what.to_owned(),
            found: path.file_name().map(PathBuf::from).into_iter().collect(),
        });
    }
    let is_enforced = match enforced(try_lock_for(&file, PATIENCE)) {
        Ok(is_enforced) => is_enforced,
        Err(TryLockError::WouldBlock) => {
            let holder = if holder.is_empty() { "another process".to_owned() } else { format!("process {holder}") };
            return Err(Error::Busy { path: what.to_owned(), holder });
        }
        Err(TryLockError::Error(error)) => return Err(error.into()),
    };
    file.set_len(0)?;
    std::io::Seek::rewind(&mut file)?;
    write!(file, "{}", std::process::id())?;
    Ok((file, is_enforced))
}

/// Whether a lock that was tried excludes others; `false` if the file system has none.
fn enforced(tried: std::result::Result<(), TryLockError>) -> std::result::Result<bool, TryLockError> {
    match tried {
        Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => Ok(false),
        tried => tried.map(|()| true),
    }
}

fn try_lock_for(file: &File, patience: Duration) -> std::result::Result<(), TryLockError> {
    let began = Instant::now();
    loop {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) if began.elapsed() < patience => std::thread::sleep(patience / 40),
            outcome => return outcome,
        }
    }
}

#[cfg(unix)]
fn is_still_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |metadata: std::fs::Metadata| (metadata.dev(), metadata.ino());
    match (file.metadata(), fs_err::symlink_metadata(path)) {
        (Ok(opened), Ok(there)) => identity(opened) == identity(there),
        _ => false,
    }
}

/// Open files cannot be removed here.
#[cfg(not(unix))]
fn is_still_at(_file: &File, _path: &Path) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Error as IoError, ErrorKind};

    #[test]
    fn a_file_system_without_locks_is_told_from_a_busy_place() {
        assert!(enforced(Ok(())).unwrap());
        assert!(!enforced(Err(TryLockError::Error(IoError::from(ErrorKind::Unsupported)))).unwrap());
        assert!(matches!(enforced(Err(TryLockError::WouldBlock)), Err(TryLockError::WouldBlock)));
    }
}
