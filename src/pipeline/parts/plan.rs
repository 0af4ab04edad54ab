//! The first part: one process decides what is to be done.

use super::Identity;
use super::PartedStage;
use super::folder::PartsFolder;
use crate::pipeline::graph::{Action, PlannedStage, check_inputs};
use crate::pipeline::run::RunFolder;
use crate::pipeline::{ComputeChoice, Result};
use crate::progress::Progress;

/// See [`InParts::plan`](super::InParts::plan).
pub(super) fn plan<S: PartedStage>(
    stage: &S,
    (folder, planned): (&RunFolder, &PlannedStage<'_>),
    compute: ComputeChoice,
    is_redone: bool,
    progress: &dyn Progress,
) -> Result<()> {
    if planned.action == Action::Reuse {
        return Ok(());
    }
    let root = folder.root();
    let identity = Identity::own(planned.expected.clone(), compute)?;
    for other in PartsFolder::all(root, stage.id())? {
        match identity.difference(other.identity()) {
            _ if is_redone => other.discard()?,
            Some(difference) => return Err(other.refusal(&difference)),
            None => return Ok(()),
        }
    }
    check_inputs(stage)?;
    let plan = stage.plan(compute, progress)?;
    PartsFolder::write(root, identity, &plan, S::n_shards(&plan))?;
    Ok(())
}
