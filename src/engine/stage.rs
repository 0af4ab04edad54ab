//! What is a stage: which section configures it, what does it read and write, and when must it be redone?

use super::failure::Result;
use super::kind::{StageInput, StageKind};
use super::shards::Sharded;
use crate::nn::Compute;
use crate::progress::Progress;
use std::path::Path;

/// One step of the pipeline.
///
/// A stage must write the same bytes whenever its configuration, its inputs and its version are the same; when it finds
/// unfinished work of its own, it may resume it, because that work has the same fingerprint.
pub trait Stage {
    /// The kind of the stage.
    fn kind(&self) -> &'static StageKind;
    /// Raised whenever a change of the code changes the outputs, so that old ones are redone.
    fn version(&self) -> u32;
    /// Rejects an invalid section, before anything runs.
    fn check(&self) -> Result<()>;
    /// Its section as JSON, without the paths of inputs, which count by their content.
    fn config(&self) -> anyhow::Result<serde_json::Value>;
    /// The inputs that it reads.
    fn inputs(&self) -> Vec<StageInput>;
    /// The outputs that it writes, among those that its kind names: files and folders within the output folder.
    fn outputs(&self) -> &'static [&'static str] {
        self.kind().outputs
    }
    /// How it does its work.
    fn work(&self) -> Work<'_>;
}

/// How a stage does its work.
pub enum Work<'a> {
    /// One process does all of it.
    Whole(&'a dyn Whole),
    /// Any number of processes make shards of it.
    Sharded(&'a dyn Sharded),
}

/// Work that one process does.
pub trait Whole {
    /// Does the work. Returns a short summary for people and for later checks.
    fn run(&self, context: &StageContext<'_>) -> Result<serde_json::Value>;
}

/// The context of a running stage.
pub struct StageContext<'a> {
    /// The folder in which it writes its outputs: not the run folder, into which they are moved once they are whole.
    pub root: &'a Path,
    /// The device and precision that networks compute on.
    pub compute: &'a Compute,
    /// Receives the progress.
    pub progress: &'a dyn Progress,
}
