//! Finds the development data for the tests that use it, and damages files.

use std::path::PathBuf;

#[path = "../../tests/skipped.rs"]
mod skipped;

/// The path of `relative` in the folder of development data, which is shared beside the crate or named by the
/// environment variable `DJINN_DATA`. If it is missing, reports that the test is skipped.
pub(crate) fn test_data(relative: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    let path = std::env::var_os("DJINN_DATA").map_or(beside, PathBuf::from).join(relative);
    if !path.exists() {
        let why = format!("{} is missing; DJINN_DATA names the folder of development data", path.display());
        skipped::skipped("recordings", &why);
        return None;
    }
    Some(path)
}

/// The bytes with some damage: at each place (taken modulo the length), a byte is exchanged, then some are removed.
/// Every seventh length cuts off the rest.
pub(crate) fn damaged(bytes: &[u8], damages: &[(usize, u8, usize)]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (place, byte, n_removed) in damages {
        if bytes.is_empty() {
            break;
        }
        let at = place % bytes.len();
        bytes[at] = *byte;
        let end = if n_removed % 7 == 6 { bytes.len() } else { bytes.len().min(at + 1 + n_removed % 7) };
        bytes.drain(at + 1..end);
    }
    bytes
}
