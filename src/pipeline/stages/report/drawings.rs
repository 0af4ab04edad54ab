//! From the samples, metrics and verdicts of a run to the drawings of the report.

use super::Report;
use crate::pipeline::layout::VERDICTS;
use crate::pipeline::stages::SampleManifest;
use crate::pipeline::{Result, StageId};
use crate::report::{Drawings, Gallery};
use crate::store::{SceneStore, read_events, read_metrics, read_verdicts};

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
    let events = match stage.has(StageId::Mine) {
        true => Some(read_events(&layout.events, |event| gallery.wants_event(event))?),
        false => None,
    };
    let (mut metrics, mut verdicts) = (Vec::new(), Vec::new());
    if stage.has(StageId::Evaluate) {
        metrics = read_metrics(&layout.metrics)?;
        let path = layout.metrics.with_file_name(VERDICTS);
        // A folder of an earlier version has no such table.
        if path.exists() {
            verdicts = read_verdicts(&path)?;
        }
    }
    Ok(gallery.finish(events.as_deref(), metrics, verdicts)?)
}
