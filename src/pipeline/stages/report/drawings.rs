//! From the samples, metrics and verdicts of a run to the drawings of the report.

use super::Report;
use crate::engine::Result;
use crate::pipeline::StageId;
use crate::pipeline::layout::VERDICTS;
use crate::pipeline::stages::SampleManifest;
use crate::report::{Drawings, Gallery};
use crate::store::{SceneStore, read_metrics, read_verdicts, stream_events};

/// Reads all samples once, shard by shard, draws those that are chosen, and compares motion and events.
pub(super) fn drawings(stage: &Report<'_>, manifest: &SampleManifest) -> Result<Drawings> {
    let layout = stage.layout;
    let store = SceneStore::open(&layout.scenes)?;
    let mut gallery = Gallery::new(stage.config, &store);
    for shard in &manifest.shards {
        for record in SampleManifest::read_shard(&layout.samples, shard, &store)? {
            gallery.offer(&record)?;
        }
    }
    let events = stage.has(StageId::Mine).then(|| stream_events(&layout.events)).transpose()?;
    let path = layout.metrics.with_file_name(VERDICTS);
    let is_evaluated = stage.has(StageId::Evaluate);
    let metrics = is_evaluated.then(|| read_metrics(&layout.metrics)).transpose()?;
    // A folder of an earlier version has no such table.
    let verdicts = (is_evaluated && path.exists()).then(|| read_verdicts(&path)).transpose()?;
    Ok(gallery.finish(events, metrics.into_iter().flatten(), verdicts.into_iter().flatten())?)
}
