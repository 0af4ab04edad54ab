//! Can this be read from its beginning to its end, as often as one likes?

use fs_err as fs;
use std::fs::Metadata;
use std::io;
use std::path::Path;

/// The metadata of a file or folder. Anything else, such as a pipe or a device, may block, have no end, or hold
/// something else the next time.
///
/// # Errors
/// On I/O errors, or if it is neither a file nor a folder.
pub fn regular(path: &Path) -> io::Result<Metadata> {
    let metadata = fs::metadata(path)?;
    if metadata.is_file() || metadata.is_dir() {
        return Ok(metadata);
    }
    let what =
        format!("{} is neither a file nor a folder; write its content to a file, and pass that file", path.display());
    Err(io::Error::new(io::ErrorKind::InvalidInput, what))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn devices_and_pipes_are_refused_and_not_opened() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [Path::new("/dev/zero"), &pipe] {
            let why = regular(path).unwrap_err().to_string();
            assert!(why.contains(&format!("{} is neither a file nor a folder", path.display())), "{why}");
        }
        assert!(regular(dir.path()).unwrap().is_dir());
    }
}
