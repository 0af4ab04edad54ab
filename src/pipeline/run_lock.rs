//! Does another process write into this folder right now?

use super::failure::{Failure, Result};
use fs_err::File;
use std::fs::TryLockError;
use std::io::{Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

/// The right to write into a folder, until dropped. It is an advisory lock that the system takes back when the process
/// ends, however it ends; so there are no stale locks. The file itself stays, empty.
#[derive(Debug)]
pub(super) struct RunLock {
    file: File,
}

/// Name of the lock file.
pub(super) const LOCK_FILE: &str = ".lock";

impl RunLock {
    /// Takes the lock on `folder`, which must exist.
    pub(super) fn acquire(folder: &Path) -> Result<Self> {
        let path = folder.join(LOCK_FILE);
        let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
        match try_lock_for(&file, PATIENCE) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                file.read_to_string(&mut holder)?;
                let holder = if holder.is_empty() { "another process".to_owned() } else { format!("process {holder}") };
                let busy = format!("{} is in use by {holder}", folder.display());
                return Err(Failure::input_message(busy).with_hint("wait for it, or choose another --run or --output"));
            }
            // Some network file systems know no locks; working without one is better than not at all.
            Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(error.into()),
        }
        file.set_len(0)?;
        write!(file, "{}", std::process::id())?;
        Ok(Self { file })
    }
}

/// A killed process may take a moment to be gone.
const PATIENCE: Duration = Duration::from_secs(2);

fn try_lock_for(file: &File, patience: Duration) -> std::result::Result<(), TryLockError> {
    let began = Instant::now();
    loop {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) if began.elapsed() < patience => std::thread::sleep(patience / 40),
            outcome => return outcome,
        }
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        // Failing to clear the number does no harm: the lock itself goes with the file handle.
        let _ = self.file.set_len(0);
    }
}
