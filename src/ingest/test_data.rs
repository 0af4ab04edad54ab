//! Finds the development data for the tests that use it, and reads small recordings whole.

use super::{Error, IngestConfig, IngestReport, RawScene, ingest};
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

/// The scene as a reader gives it, without doubts.
pub(crate) fn raw(scene: Scene) -> RawScene {
    let Scene { id, source, dt_s, n_timesteps, n_history, tracks, map_id, .. } = scene;
    let (heading_gaps, findings) = (Vec::new(), Vec::new());
    let map_id = map_id.unwrap_or_else(|| "Test".into());
    RawScene { id, source, dt_s, n_timesteps, n_history, tracks, heading_gaps, map_id, own_map: None, findings }
}
