//! A stage that is divided into shards, which any number of processes make: who plans, who makes which shard, who
//! publishes?
//!
//! A shard is a function of the plan and its index alone, so there are no leases and no coordinator: if two workers
//! make the same shard, that costs time but not correctness. One process plans ([`plan`]), workers make shards
//! ([`work`]) below `<stage>.parts/<plan-id>/`, and one process publishes (`ready`). Only the first and the last hold
//! the lock of the run folder; workers remove nothing but their own marks. A process that runs the stage alone does all
//! three, as worker 1 of 1, and so writes the same bytes.

#[cfg(test)]
mod alone_tests;
mod division;
mod folder;
mod gathering;
mod identity;
mod make;
mod plan_files;
mod progress;
#[cfg(test)]
mod tests;
mod tries;

pub use division::Division;
pub use gathering::Gathering;
pub use make::{Shards, Worker, work};
pub use progress::{ShardStatus, shard_status};

use super::failure::{Failure, Result};
use super::inputs::check_inputs;
use super::kind::StageKind;
use super::planned::{Action, PlannedStage};
use super::record::StageRecord;
use super::stage::{Stage, StageContext, Work};
use super::{ComputeChoice, log};
use crate::nn::Compute;
use crate::progress::Progress;
use crate::settings::Unreadable;
pub(super) use folder::ShardFolder;
use identity::Identity;
use serde_json::Value;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// The work of a stage that is divided into shards. Its kind names their files
/// ([`ShardNames`](super::ShardNames)).
pub trait Sharded {
    /// Decides which shards there are.
    fn plan(&self, compute: &Compute, progress: &dyn Progress) -> Result<Division>;
    /// Makes shards until each is finished, not needed or given up.
    fn make(&self, shards: &Shards<'_>, compute: &Compute) -> Result<()>;
    /// Writes the outputs from the finished shards into the work folder. Returns a short summary, as
    /// [`Whole::run`](super::stage::Whole::run).
    fn finish(&self, shards: &mut Gathering<'_>, context: &StageContext<'_>) -> Result<Value>;
}

/// Who makes the shards of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Makers {
    /// This process makes the missing ones.
    Alone,
    /// Workers have made them.
    Workers,
}

/// Plans the stage that is `planned` in the folder `root`, which must be locked, for any number of workers. An existing
/// plan for the same work stays.
///
/// # Errors
/// When the folder has another plan for workers, unless the stage was requested to be done again; errors of planning.
pub fn plan(root: &Path, planned: &PlannedStage<'_>, compute: ComputeChoice, progress: &dyn Progress) -> Result<()> {
    let stage = planned.stage.as_ref();
    let Work::Sharded(sharded) = stage.work() else { return Ok(()) };
    if planned.action == Action::Reuse {
        return Ok(());
    }
    let identity = Identity::own(planned.stage.kind(), planned.expected.clone(), compute)?;
    for other in ShardFolder::all(root, stage.kind())? {
        match other.difference(&identity) {
            _ if planned.is_requested => other.discard()?,
            None => return other.shared(false).map(drop),
            Some(_) if !other.is_shared() => other.discard()?,
            Some(difference) => return Err(other.refusal(&difference)),
        }
    }
    check_inputs(stage)?;
    let division = sharded.plan(&open(stage, compute)?, progress)?;
    let plan = ShardFolder::write(root, stage.kind(), identity, &division)?;
    plan.shared(planned.is_requested).map(drop)
}

/// The shards from which a stage is finished: those of workers, or otherwise those that this process makes.
pub(super) fn ready(
    planned: &PlannedStage<'_>,
    sharded: &dyn Sharded,
    (compute, makers): (ComputeChoice, Makers),
    context: &StageContext<'_>,
) -> Result<ShardFolder> {
    let identity = Identity::own(planned.stage.kind(), planned.expected.clone(), compute)?;
    match makers {
        Makers::Alone => alone(planned, sharded, identity, context),
        Makers::Workers => ShardFolder::of(context.root, planned.stage.kind(), &identity)?.ok_or_else(|| {
            Failure::later(format_args!("{} holds no plan to seal yet", context.root.display()))
                .with_hint("run the parts plan and work first; this command can be repeated until then")
        }),
    }
}

/// Plans the stage, unless that is done, and makes the missing shards.
fn alone(
    planned: &PlannedStage<'_>,
    sharded: &dyn Sharded,
    identity: Identity,
    context: &StageContext<'_>,
) -> Result<ShardFolder> {
    let StageContext { root, compute, progress } = *context;
    let kind = planned.stage.kind();
    ShardFolder::remove_remains(root, kind)?;
    let mut begun = None;
    for other in ShardFolder::all(root, kind)? {
        match other.difference(&identity) {
            None if !(planned.is_requested && other.is_shared()) => begun = Some(other),
            Some(difference) if other.is_shared() && !planned.is_requested => progress.warn(&format!(
                "{kind}: the shards of workers in {kind}.parts belong to another plan and are not used: {difference}; \
                 discard them with --stage {kind} --part plan --redo {kind}"
            )),
            difference => {
                // The plan announced that it resumes.
                if let Some(difference) = difference.filter(|_| planned.action == Action::Resume) {
                    progress.warn(&format!("{kind}: the shards of the interrupted run are made again: {difference}"));
                }
                other.discard()?;
            }
        }
    }
    let folder = match begun {
        Some(folder) => {
            folder.forget_failures()?;
            folder
        }
        None => ShardFolder::write(root, kind, identity, &sharded.plan(compute, progress)?)?,
    };
    sharded.make(&Shards::new(&folder, Worker::ALONE, progress), compute)?;
    Ok(folder)
}

/// Removes the plans and shards of the stage with this record, once it is finished. Plans for other work stay; workers'
/// logs are appended to the log of the run.
pub(super) fn clean_up(root: &Path, stage: &'static StageKind, done: &StageRecord) -> Result<()> {
    for folder in ShardFolder::all(root, stage)? {
        if folder.identity().is_work_of(done) {
            folder.append_logs(&root.join(log::LOG_FILE))?;
            folder.discard()?;
        }
    }
    ShardFolder::remove_remains(root, stage)
}

/// Opens the device for a stage; one without networks needs none.
fn open(stage: &dyn Stage, compute: ComputeChoice) -> Result<Compute> {
    if stage.kind().computes { compute.open() } else { Ok(Compute::cpu()) }
}

/// A part of a stage in shards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Plans the work: one process.
    Plan,
    /// Makes shards: any number of processes.
    Work,
    /// Publishes the results: one process.
    Seal,
}

impl FromStr for Part {
    type Err = Unreadable;

    fn from_str(name: &str) -> Result<Self, Unreadable> {
        let known = [Self::Plan, Self::Work, Self::Seal].into_iter().find(|part| part.to_string() == name);
        known.ok_or_else(|| "expected plan, work or seal".into())
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Plan => "plan",
            Self::Work => "work",
            Self::Seal => "seal",
        })
    }
}
