//! Makes the drawings of the report from the samples, metrics and verdicts of a run.

use super::Report;
use crate::engine::Result;
use crate::pipeline::StageId;
use crate::pipeline::layout::VERDICTS;
use crate::pipeline::stages::SampleManifest;
use crate::report::{Accepted, Drawings, Gallery};
use crate::store::{SceneStore, stream_events, stream_table};
use std::path::PathBuf;

/// Reads all samples once, shard by shard, draws the chosen ones, and compares motion and events.
pub(super) fn drawings(stage: &Report<'_>, manifest: &SampleManifest) -> Result<Drawings> {
    let layout = stage.layout;
    let store = SceneStore::open_all(&layout.scene_folders())?;
    let is_evaluated = stage.has(StageId::Evaluate);
    let accepted = is_evaluated.then(|| accepted(stage)).transpose()?;
    let mut gallery = Gallery::new(stage.config, &store, accepted.as_ref());
    for shard in &manifest.shards {
        for record in SampleManifest::read_shard(&layout.samples, shard, &store)? {
            gallery.offer(&record)?;
        }
    }
    let events = stage.has(StageId::Mine).then(|| stream_events(&layout.events)).transpose()?;
    let metrics = is_evaluated.then(|| stream_table(&layout.metrics)).transpose()?;
    let verdicts = is_evaluated.then(|| stream_table(&verdicts_of(stage))).transpose()?;
    Ok(gallery.finish(events, metrics.into_iter().flatten(), verdicts.into_iter().flatten())?)
}

fn verdicts_of(stage: &Report<'_>) -> PathBuf {
    stage.layout.metrics.with_file_name(VERDICTS)
}

/// The accepted scenarios, and how hard they are.
fn accepted(stage: &Report<'_>) -> Result<Accepted> {
    let mut accepted = Accepted::default();
    for row in stream_table(&verdicts_of(stage))? {
        accepted.add_verdict(row?);
    }
    for row in stream_table(&stage.layout.metrics)? {
        accepted.add_metric(&row?);
    }
    Ok(accepted)
}
