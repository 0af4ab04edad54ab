//! What is a stage: which section configures it, what does it read and write, and when must it be redone?

use super::failure::Result;
use super::shards::Sharded;
use crate::nn::Compute;
use crate::progress::Progress;
use crate::settings::Unreadable;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The stages, in the order in which they run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageId {
    /// Recordings to scenes.
    Ingest,
    /// Scenes to events.
    Mine,
    /// Scenes to a denoiser.
    TrainDenoiser,
    /// A denoiser to one that needs few evaluations.
    TrainDistill,
    /// Scenes and events to a classifier of noised scenes.
    TrainClassifier,
    /// Scenes to a Scene Transformer, to compare the denoiser with.
    TrainBaseline,
    /// Scenes and models to generated scenarios.
    Generate,
    /// Generated scenarios to metrics and the corpus.
    Evaluate,
    /// Metrics and corpus to a page for people.
    Report,
}

impl StageId {
    /// Every stage, in the order in which they run.
    pub const ALL: [Self; 9] = [
        Self::Ingest,
        Self::Mine,
        Self::TrainDenoiser,
        Self::TrainDistill,
        Self::TrainClassifier,
        Self::TrainBaseline,
        Self::Generate,
        Self::Evaluate,
        Self::Report,
    ];

    /// The name in file names and messages.
    pub const fn name(self) -> &'static str {
        self.facts().name
    }
}

impl FromStr for StageId {
    type Err = Unreadable;

    fn from_str(name: &str) -> Result<Self, Unreadable> {
        Self::ALL.into_iter().find(|stage| stage.name() == name).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|stage| stage.name()).collect();
            Unreadable(format!("unknown stage; known stages: {}", known.join(", ")))
        })
    }
}

impl fmt::Display for StageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Something a stage reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StageInput {
    /// Its name within the stage, such as `scenes`; unique there.
    pub name: String,
    /// Where it is.
    pub path: PathBuf,
    /// The stage that makes such things; `None` for recordings and other files from outside.
    pub producer: Option<StageId>,
}

impl StageInput {
    /// Something that another stage made.
    pub fn made_by(producer: StageId, name: &str, path: &Path) -> Self {
        Self { name: name.to_owned(), path: path.to_owned(), producer: Some(producer) }
    }

    /// Something from outside.
    pub fn external(name: impl Into<String>, path: &Path) -> Self {
        Self { name: name.into(), path: path.to_owned(), producer: None }
    }
}

/// One step of the pipeline.
///
/// A stage must write the same bytes whenever its configuration, its inputs and its version are the same; when it finds
/// unfinished work of its own, it may resume it, because that work has the same fingerprint.
pub trait Stage {
    /// Which stage this is.
    fn id(&self) -> StageId;
    /// Raised whenever the code changes what the stage writes, so that old outputs are redone.
    fn version(&self) -> u32;
    /// Refuses a section that cannot work, before anything runs.
    ///
    /// # Errors
    /// When a value cannot work, naming it.
    fn check(&self) -> Result<()>;
    /// Its section, as JSON.
    fn config(&self) -> anyhow::Result<serde_json::Value>;
    /// What it reads.
    fn inputs(&self) -> Vec<StageInput>;
    /// What it writes: names of files and folders within the output folder, of those that its facts name.
    fn outputs(&self) -> &'static [&'static str] {
        self.id().facts().outputs
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
    /// The folder in which it writes its outputs: not the run folder, to which they come once they are whole.
    pub root: &'a Path,
    /// What networks compute on.
    pub compute: &'a Compute,
    /// Receives the progress.
    pub progress: &'a dyn Progress,
}
