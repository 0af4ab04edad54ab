//! A stage by any number of processes on a shared folder: who plans, who makes which shard, who publishes?
//!
//! A shard is a function of the plan and its index alone. So there are no leases and no coordinator: a shard that two workers
//! make costs time, never correctness. One process plans ([`plan`]), workers make shards ([`work`]) below
//! `<stage>.parts/<plan-id>/`, and one process publishes what a single process would have written ([`seal`]). Only the first
//! and the last hold the lock of the run folder and remove anything but their own marks. What is particular to a stage is a
//! [`PartedStage`]: `generation`, `evaluation`.

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
use folder::PartsFolder;
use gathering::Gathering;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;
use std::str::FromStr;
use work::Shards;

/// What is particular to a stage that several processes can run. Its facts name its shards
/// ([`PartFacts`](super::stage_facts::PartFacts)).
trait PartedStage: Stage {
    /// What is decided before any shard is made.
    type Plan: Serialize + DeserializeOwned;
    /// What is known of a finished shard.
    type Shard: PartFile;

    /// Decides what shards there are.
    fn plan(&self, compute: ComputeChoice, progress: &dyn Progress) -> Result<Self::Plan>;
    /// Number of shards that the plan knows of.
    fn n_shards(plan: &Self::Plan) -> usize;
    /// Goes about the shards until each is finished, unwanted or given up.
    fn work(&self, plan: &Self::Plan, shards: &Shards<'_, Self::Shard>, compute: ComputeChoice) -> Result<()>;
    /// Gathers the shards that one process would have made.
    fn gather(&self, plan: &Self::Plan, shards: &mut Gathering<'_, Self::Shard>) -> Result<()>;
    /// Brings gathered shards into the folder `work`, where the stage takes them for its own.
    fn publish(
        &self,
        plan: &Self::Plan,
        shards: &[(usize, Self::Shard)],
        parts: &PartsFolder,
        work: &Path,
    ) -> Result<()>;
}

/// What is known of a shard: at least its file.
trait PartFile: Clone + PartialEq + Serialize + DeserializeOwned {
    /// The name of the file, with its size and hash.
    fn file(&self) -> (&str, &FileStamp);
}

/// A shard of which nothing but its file needs to be known.
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
    /// Plans the stage that is `planned`, for any number of workers. What is planned already stays.
    ///
    /// # Errors
    /// When another plan is at work in the folder and `is_redone` does not say that it is given up; those of planning.
    fn plan(
        &self,
        folder: &RunFolder,
        planned: &PlannedStage<'_>,
        compute: ComputeChoice,
        is_redone: bool,
        progress: &dyn Progress,
    ) -> Result<()>;

    /// Makes shards of the plan in the run folder `root` until none is left to be begun.
    ///
    /// # Errors
    /// When there is no plan yet ([`Blame::Later`](super::Blame::Later)), or the plan is of another configuration, program or kind of
    /// device; those of the work.
    fn work(&self, root: &Path, worker: Worker, compute: ComputeChoice, progress: &dyn Progress) -> Result<()>;

    /// Takes over the shards of the workers into the work of the stage that is `planned`, which then only finishes it: it runs next, and
    /// [`sealed`] after it.
    ///
    /// # Errors
    /// When shards are missing: [`Blame::Later`](super::Blame::Later) while they may still come, a fault once all of them are given
    /// up. When there is no plan, or it is another one.
    fn seal(&self, folder: &RunFolder, planned: &mut PlannedStage<'_>, compute: ComputeChoice) -> Result<()>;

    /// Takes over what workers have finished of the stage that is `planned`, which runs next by one process and does the rest.
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

/// The stage, where it can be run in parts and the configuration has its section.
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
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = [Self::Plan, Self::Work, Self::Seal].into_iter().find(|part| part.to_string() == name);
        known.ok_or_else(|| "expected plan, work or seal".to_owned())
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
