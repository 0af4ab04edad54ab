//! The first part: one process decides what is sampled.

use super::folder::PartsFolder;
use super::identity::{Identity, refusal};
use crate::pipeline::graph::{Action, PlannedStage, check_inputs};
use crate::pipeline::run::RunFolder;
use crate::pipeline::stages::Generate;
use crate::pipeline::{ComputeChoice, Result};
use crate::progress::Progress;

/// Plans the stage that is `planned`, for any number of workers. What is planned already stays.
///
/// # Errors
/// When another plan is at work in the folder and `is_redone` does not say that it is given up; those of planning.
pub fn plan(
    folder: &RunFolder,
    planned: &PlannedStage<'_>,
    generate: &Generate<'_>,
    compute: ComputeChoice,
    is_redone: bool,
    progress: &dyn Progress,
) -> Result<()> {
    if planned.action == Action::Reuse {
        return Ok(());
    }
    let root = folder.root();
    let identity = Identity::own(planned.expected.clone(), compute)?;
    for other in PartsFolder::all(root)? {
        match identity.difference(&other.identity) {
            _ if is_redone => other.discard()?,
            Some(difference) => return Err(refusal(&difference)),
            None => return Ok(()),
        }
    }
    check_inputs(generate)?;
    let plan = generate.with_ready(&compute.open()?, |ready| ready.plan(progress))?;
    PartsFolder::write(root, identity, &plan)?;
    Ok(())
}
