//! The last part: one process publishes the workers' shards as if it had made everything itself.

use super::Identity;
use super::PartedStage;
use super::folder::PartsFolder;
use super::gathering::Gathering;
use crate::pipeline::graph::{Action, PlannedStage};
use crate::pipeline::run::RunFolder;
use crate::pipeline::work::Work;
use crate::pipeline::{ComputeChoice, Failure, Result, StageId};
use std::path::Path;

/// What one process took over from the workers of a stage.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TakenOver {
    /// No workers had begun.
    Nothing,
    /// So many of so many shards. [`sealed`] removes the workers' files once the stage is done.
    Shards(usize, usize),
    /// Nothing, because the workers' plan differs in this way. It stays.
    Refused(String),
}

/// See [`InParts::seal`](super::InParts::seal).
pub(super) fn seal<S: PartedStage>(
    stage: &S,
    folder: &RunFolder,
    planned: &mut PlannedStage<'_>,
    compute: ComputeChoice,
) -> Result<()> {
    if planned.action == Action::Reuse {
        return Ok(());
    }
    let root = folder.root();
    let Some(parts) = PartsFolder::of(root, &Identity::own(planned.expected.clone(), compute)?)? else {
        return Err(Failure::later(format_args!("{} holds no plan to seal yet", root.display()))
            .with_hint("run the parts plan and work first; this command can be repeated until then"));
    };
    let plan: S::Plan = parts.plan()?;
    let mut shards = Gathering::new(&parts, S::n_shards(&plan));
    stage.gather(&plan, &mut shards)?;
    let shards = shards.whole()?;
    publish(stage, root, planned, (&parts, &plan), &shards)
}

/// See [`InParts::take_over`](super::InParts::take_over).
pub(super) fn take_over<S: PartedStage>(
    stage: &S,
    folder: &RunFolder,
    planned: &mut PlannedStage<'_>,
    compute: ComputeChoice,
) -> Result<TakenOver> {
    let root = folder.root();
    PartsFolder::remove_remains(root, stage.id())?;
    let begun = PartsFolder::all(root, stage.id())?;
    let Some(last) = begun.last().filter(|_| planned.action != Action::Reuse) else { return Ok(TakenOver::Nothing) };
    let own = Identity::own(planned.expected.clone(), compute)?;
    let Some(parts) = begun.iter().find(|parts| own.difference(parts.identity()).is_none()) else {
        return Ok(TakenOver::Refused(own.difference(last.identity()).unwrap_or_default()));
    };
    let plan: S::Plan = parts.plan()?;
    let mut shards = Gathering::new(parts, S::n_shards(&plan));
    stage.gather(&plan, &mut shards)?;
    let (shards, n_shards) = shards.found();
    publish(stage, root, planned, (parts, &plan), &shards)?;
    Ok(TakenOver::Shards(shards.len(), n_shards))
}

/// Puts shards into the work folder of the stage, which continues from there.
fn publish<S: PartedStage>(
    stage: &S,
    root: &Path,
    planned: &mut PlannedStage<'_>,
    (parts, plan): (&PartsFolder, &S::Plan),
    shards: &[(usize, S::Shard)],
) -> Result<()> {
    let work = match planned.action {
        Action::Resume => Work::resume(root, &planned.expected)?,
        _ => Work::begin(root, &planned.expected)?,
    };
    stage.publish(plan, shards, parts, work.path())?;
    planned.action = Action::Resume;
    Ok(())
}

/// Removes the plans and shards of `stage` in `root`, once they are published. The workers' logs are appended to the
/// log of the run.
///
/// # Errors
/// Those of the file system; when somebody else put files there.
pub fn sealed(root: &Path, stage: StageId) -> Result<()> {
    for parts in PartsFolder::all(root, stage)? {
        parts.append_logs(&root.join(crate::pipeline::log::LOG_FILE))?;
        parts.discard()?;
    }
    PartsFolder::remove_remains(root, stage)
}
