//! Where does the development data lie, for the tests that use it?

use std::path::PathBuf;

/// The path of `relative` in the folder of development data, which is shared beside the crate or named by the environment
/// variable `DJINN_DATA`. Where it is missing, says that the test is skipped.
pub(crate) fn test_data(relative: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    let path = std::env::var_os("DJINN_DATA").map_or(beside, PathBuf::from).join(relative);
    if !path.exists() {
        #[expect(clippy::print_stderr, reason = "a skipped test must say so")]
        {
            eprintln!("skipped: {} is missing; set DJINN_DATA to the folder of development data", path.display());
        }
        return None;
    }
    Some(path)
}
