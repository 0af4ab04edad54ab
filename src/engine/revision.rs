//! The version and revision of the program.

use super::Result;
use std::sync::OnceLock;

/// The version and the revision of the program.
pub fn version() -> Result<String> {
    Ok(format!("{} ({})", env!("CARGO_PKG_VERSION"), revision()?))
}

/// The revision of the source, or a hash of the program if it was unknown to the build.
pub(super) fn revision() -> Result<String> {
    static KNOWN: OnceLock<String> = OnceLock::new();
    if let Some(revision) = option_env!("DJINN_REVISION").or(KNOWN.get().map(String::as_str)) {
        return Ok(revision.to_owned());
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(fs_err::File::open(std::env::current_exe()?)?)?;
    let hash = hasher.finalize().to_hex();
    Ok(KNOWN.get_or_init(|| format!("build {}", hash.get(..12).unwrap_or_default())).clone())
}
