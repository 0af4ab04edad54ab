//! Finds the development data for the tests that use it.

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
