//! Reads what earlier runs left of a stage.

use super::earlier::Earlier;
use super::failure::Result;
use super::kind::StageKind;
use super::record::StageRecord;
use super::shards::ShardFolder;
use super::timings::Timings;
use super::work_folder::WorkFolder;
use std::path::Path;

/// What earlier runs left of a stage in `root`.
pub(super) fn left(root: &Path, stage: &'static StageKind) -> Result<Earlier> {
    let (plans, timings) = (ShardFolder::all(root, stage)?, Timings::read(root));
    Ok(Earlier {
        stage,
        begun: unfinished(root, stage, &plans)?,
        done: StageRecord::done(root, stage)?,
        is_redone: plans.iter().any(ShardFolder::redoes),
        times_seen: timings.times_seen(stage),
        seconds_spent: timings.seconds_spent(stage),
    })
}

/// The record of unfinished work on a stage in `root`, if there is any.
pub fn begun(root: &Path, stage: &'static StageKind) -> Result<Option<StageRecord>> {
    unfinished(root, stage, &ShardFolder::all(root, stage)?)
}

fn unfinished(root: &Path, stage: &'static StageKind, plans: &[ShardFolder]) -> Result<Option<StageRecord>> {
    Ok(WorkFolder::started(root, stage)?.or_else(|| Some(plans.last()?.identity().stage.clone())))
}
