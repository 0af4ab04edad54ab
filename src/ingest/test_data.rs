//! Finds the development data for the tests that use it, and reads small recordings whole.

use super::{Error, IngestConfig, IngestReport, ingest};
use crate::progress::Silent;
use crate::scene::Scene;
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

/// All scenes of some recordings, and the report on them.
pub(crate) fn scenes(config: &IngestConfig) -> Result<(Vec<Scene>, IngestReport), Error> {
    let mut scenes = Vec::new();
    let report = ingest(config, None, &Silent, &mut |batch| {
        scenes.extend(batch.scenes);
        Ok(())
    })?;
    Ok((scenes, report))
}
