//! A stage run by any number of processes on a shared folder: who plans, who makes which shard, who publishes?
//!
//! A shard is a function of the plan and its index alone, so there are no leases and no coordinator: if two workers
//! make the same shard, that costs time but not correctness. One process plans ([`plan`]), workers make shards
//! ([`work`]) below `<stage>.parts/<plan-id>/`, and one process publishes what a single process would have written
//! ([`seal`]). Only the first and the last hold the lock of the run folder; workers remove nothing but their own marks.
//! Each stage that can be divided implements [`PartedStage`]: `generation`, `evaluation`.

mod evaluation;
mod folder;
mod gathering;
mod generation;
mod plan;
mod progress;
mod requests;
mod seal;
#[cfg(test)]
mod tests;
mod tries;
mod work;

pub use super::identity::Identity;
pub use progress::{ShardStatus, shard_status};
pub use seal::{TakenOver, sealed};
pub use work::Worker;

use super::config::PipelineConfig;
use super::graph::PlannedStage;
use super::layout::Layout;
use super::run::RunFolder;
use super::stage::{Stage, StageId};
use super::stages;
use super::{ComputeChoice, Result};
use crate::files::FileStamp;
use crate::progress::Progress;
use crate::settings::Unreadable;
use folder::PartsFolder;
use gathering::Gathering;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;
use std::str::FromStr;
use work::Shards;

/// A stage that several processes can run. Its facts name its shards ([`PartFacts`](super::stage_facts::PartFacts)).
trait PartedStage: Stage {
    /// The decisions made before any shard.
    type Plan: Serialize + DeserializeOwned;
    /// The record of a finished shard.
    type Shard: PartFile;

    /// Decides what shards there are.
    fn plan(&self, compute: ComputeChoice, progress: &dyn Progress) -> Result<Self::Plan>;
    /// Number of shards in the plan.
    fn n_shards(plan: &Self::Plan) -> usize;
    /// Works on the shards until each is finished, not needed or given up.
    fn work(&self, plan: &Self::Plan, shards: &Shards<'_, Self::Shard>, compute: ComputeChoice) -> Result<()>;
    /// Gathers the shards that one process would have made.
    fn gather(&self, plan: &Self::Plan, shards: &mut Gathering<'_, Self::Shard>) -> Result<()>;
    /// Puts gathered shards into the folder `work`, where the stage finds them as if it had made them.
    fn publish(
        &self,
        plan: &Self::Plan,
        shards: &[(usize, Self::Shard)],
        parts: &PartsFolder,
        work: &Path,
    ) -> Result<()>;
}

/// The record of a shard, which names at least its file.
trait PartFile: Clone + PartialEq + Serialize + DeserializeOwned {
    /// The name of the file, with its size and hash.
    fn file(&self) -> (&str, &FileStamp);
}

/// The record of a shard that needs nothing but its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct StampedFile {
    file: String,
    stamp: FileStamp,
}

impl PartFile for StampedFile {
    fn file(&self) -> (&str, &FileStamp) {
        (&self.file, &self.stamp)
    }
}

/// A stage that can be run in parts.
pub trait InParts {
    /// Plans the stage that is `planned` for any number of workers. An existing plan of the same identity stays.
    ///
    /// # Errors
    /// When the folder has another plan and `is_redone` does not allow discarding it; those of planning.
    fn plan(
        &self,
        folder: &RunFolder,
        planned: &PlannedStage<'_>,
        compute: ComputeChoice,
        is_redone: bool,
        progress: &dyn Progress,
    ) -> Result<()>;

    /// Makes shards of the plan in the run folder `root` until none is left to start.
    ///
    /// # Errors
    /// When there is no plan yet ([`Blame::Later`](super::Blame::Later)), or the plan belongs to another configuration,
    /// program or kind of device; those of the work.
    fn work(&self, root: &Path, worker: Worker, compute: ComputeChoice, progress: &dyn Progress) -> Result<()>;

    /// Moves the workers' shards into the work folder of the stage that is `planned`. The stage runs next and only has
    /// to finish; [`sealed`] comes after it.
    ///
    /// # Errors
    /// When shards are missing: [`Blame::Later`](super::Blame::Later) while they may still come, a fault once all of
    /// them are given up. When there is no plan, or only that of another identity.
    fn seal(&self, folder: &RunFolder, planned: &mut PlannedStage<'_>, compute: ComputeChoice) -> Result<()>;

    /// Moves the finished shards of workers into the work folder of the stage that is `planned`. One process runs the
    /// stage next and does the rest.
    ///
    /// # Errors
    /// Those of the file system.
    fn take_over(
        &self,
        folder: &RunFolder,
        planned: &mut PlannedStage<'_>,
        compute: ComputeChoice,
    ) -> Result<TakenOver>;
}

impl<S: PartedStage> InParts for S {
    fn plan(
        &self,
        folder: &RunFolder,
        planned: &PlannedStage<'_>,
        compute: ComputeChoice,
        is_redone: bool,
        progress: &dyn Progress,
    ) -> Result<()> {
        plan::plan(self, (folder, planned), compute, is_redone, progress)
    }

    fn work(&self, root: &Path, worker: Worker, compute: ComputeChoice, progress: &dyn Progress) -> Result<()> {
        work::work(self, root, worker, compute, progress)
    }

    fn seal(&self, folder: &RunFolder, planned: &mut PlannedStage<'_>, compute: ComputeChoice) -> Result<()> {
        seal::seal(self, folder, planned, compute)
    }

    fn take_over(
        &self,
        folder: &RunFolder,
        planned: &mut PlannedStage<'_>,
        compute: ComputeChoice,
    ) -> Result<TakenOver> {
        seal::take_over(self, folder, planned, compute)
    }
}

/// The stage, if it can be run in parts and the configuration has its section.
pub fn in_parts<'a>(id: StageId, config: &'a PipelineConfig, layout: &'a Layout) -> Option<Box<dyn InParts + 'a>> {
    Some(match id {
        StageId::Generate => Box::new(stages::generation(config, layout)?),
        StageId::Evaluate => Box::new(stages::evaluation(config, layout)?),
        _ => return None,
    })
}

/// A part of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Decides what is done: one process.
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
