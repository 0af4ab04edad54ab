//! Exchanges two folders, without a moment in which a place is empty.

use std::io;
use std::path::Path;

/// Exchanges the entries under two paths, at once. `false`: nothing was done, because the system or the file system
/// cannot.
#[cfg(target_os = "linux")]
pub fn exchange(a: &Path, b: &Path) -> io::Result<bool> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use rustix::io::Errno;
    match renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE) {
        Ok(()) => Ok(true),
        Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => Ok(false),
        Err(error) => Err(io::Error::new(
            io::Error::from(error).kind(),
            format!("failed to exchange {} and {}: {error}", a.display(), b.display()),
        )),
    }
}

/// Only Linux has a call for it that is of use here.
#[cfg(not(target_os = "linux"))]
pub fn exchange(_a: &Path, _b: &Path) -> io::Result<bool> {
    Ok(false)
}
