//! What does a run folder hold, and how is a pipeline run in it?
//!
//! Beside the outputs of the stages: `config.toml` (the resolved configuration), `run.json` (versions, seed, device,
//! input fingerprints, state of every stage), `timings.json` and `log.txt`. Two runs of one pipeline on the same inputs
//! differ in the last two alone: everything that distinguishes one run from another is kept there.

use super::device::ComputeChoice;
use super::execute::execute;
use super::failure::{Blame, Failure, Result};
use super::kind::StageKind;
use super::log::{LOG_FILE, Logged};
use super::ownership;
pub use super::ownership::{CONFIG_FILE, RUN_FILE};
use super::planned::{Action, PlannedStage};
use super::record::{InputRecord, StageRecord};
use super::revision::revision;
use super::shards::Makers;
use super::stage::StageContext;
use super::timings::StageClock;
pub use super::timings::{StageTiming, TIMINGS_FILE, Timings};
use super::work_folder::WorkFolder;
use crate::files::Lock;
use crate::nn::Compute;
use crate::progress::Progress;
use crate::store::{write_atomically, write_record};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The content of `run.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunManifest {
    /// Version of the program.
    pub djinn_version: String,
    /// Revision of its source, if known to the build.
    pub revision: Option<String>,
    /// Name of the pipeline.
    pub pipeline: String,
    /// Seed of the run.
    pub seed: u64,
    /// The device that the tensors were computed on.
    pub device: String,
    /// Files and folders from outside, by stage and name.
    pub inputs: BTreeMap<String, InputRecord>,
    /// The stages by name.
    pub stages: BTreeMap<String, StageState>,
}

/// The entry of a stage in `run.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageState {
    /// Hash of its version, configuration and inputs.
    pub fingerprint: String,
    /// Whether its outputs are whole.
    pub status: StageStatus,
    /// Its outputs, by name within the run folder.
    pub outputs: BTreeMap<String, super::PathFingerprint>,
}

/// The progress of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageStatus {
    /// Not run yet, or not to the end.
    Pending,
    /// Its outputs are whole.
    Done,
}

/// A run's description of itself.
#[derive(Debug, Clone)]
pub struct RunAbout {
    /// Name of the pipeline.
    pub pipeline: String,
    /// Seed of the run.
    pub seed: u64,
    /// The device that the tensors are computed on.
    pub device: String,
    /// The resolved configuration, as TOML.
    pub config: String,
}

/// Runs planned stages in a folder, keeping its log and timings; with `about`, also its configuration and manifest. The
/// stages must have been planned while the folder was open, so that no other process has changed it since.
pub fn run_stages(
    folder: &RunFolder,
    about: Option<&RunAbout>,
    (choice, makers): (ComputeChoice, Makers),
    planned: Vec<PlannedStage<'_>>,
    progress: &dyn Progress,
) -> Result<Vec<StageRecord>> {
    // A machine without the device may run stages that do not need it.
    let computes = planned.iter().any(|planned| planned.action != Action::Reuse && planned.stage.kind().computes);
    let compute = if computes { choice.open()? } else { Compute::cpu() };
    let root = folder.root.as_path();
    let logged = Logged::open(&root.join(LOG_FILE), progress)?;
    logged.line(&format!("djinn {} begins in {}", env!("CARGO_PKG_VERSION"), root.display()));
    for PlannedStage { expected, action, .. } in &planned {
        logged.line(&format!("{}: {action}", expected.stage));
    }
    if !folder.lock.is_enforced() {
        logged.warn(
            "the file system of the run folder does not support locks: make sure that no other process writes there",
        );
    }
    let mut manifest = about.map(|about| RunManifest::new(about, &planned));
    let mut save = |record: Option<&StageRecord>| -> anyhow::Result<()> {
        let Some(manifest) = &mut manifest else { return Ok(()) };
        if let Some(record) = record {
            manifest.stages.insert(record.stage.to_string(), StageState::done(record));
        }
        write_record(&root.join(RUN_FILE), manifest)?;
        Ok(())
    };
    save(None)?;
    // Written after the manifest, beside which it is not mistaken for a foreign file.
    if let Some(RunAbout { config, .. }) = about {
        write_atomically::<std::io::Error>(&root.join(CONFIG_FILE), |file| file.write_all(config.as_bytes()))?;
    }
    let mut clock = StageClock::open(root);
    let context = StageContext { root, compute: &compute, progress: &logged };
    let after = &mut |record: &StageRecord| save(Some(record));
    let outcome = execute(planned, (choice, makers), &context, (&logged, &mut clock), after);
    match &outcome {
        Ok(_) => logged.line("done"),
        Err(Failure { blame: Blame::Later, error, .. }) => logged.line(&format!("stopped: {error:#}")),
        Err(failure) => logged.line(&format!("failed: {:#}", failure.error)),
    }
    outcome
}

/// A folder to write into, locked against other processes.
pub struct RunFolder {
    root: PathBuf,
    lock: Lock,
}

impl RunFolder {
    /// Its path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Creates the folder, takes its lock, and finishes what a killed process was about to finish.
    ///
    /// # Errors
    /// When another process has the lock, or files of the folder that would be written are foreign.
    pub fn open(root: &Path, kinds: &'static [StageKind]) -> Result<Self> {
        ownership::check_root(root, kinds)?;
        fs_err::create_dir_all(root)?;
        let lock = Lock::in_folder(root)?;
        ownership::remove_leftovers(root, kinds)?;
        WorkFolder::complete_all(root, kinds)?;
        Ok(Self { root: root.to_owned(), lock })
    }
}

impl RunManifest {
    fn new(about: &RunAbout, planned: &[PlannedStage<'_>]) -> Self {
        let external = planned.iter().flat_map(|PlannedStage { expected, .. }| {
            let paths = expected.inputs.iter().filter(|(_, input)| matches!(input, InputRecord::Path { .. }));
            paths.map(|(name, input)| (format!("{}/{name}", expected.stage), input.clone()))
        });
        let pending = |PlannedStage { expected, action, .. }: &PlannedStage<'_>| {
            let status = if *action == Action::Reuse { StageStatus::Done } else { StageStatus::Pending };
            let state = StageState { fingerprint: expected.fingerprint.clone(), status, outputs: BTreeMap::new() };
            (expected.stage.to_string(), state)
        };
        Self {
            djinn_version: env!("CARGO_PKG_VERSION").to_owned(),
            revision: revision().ok(),
            pipeline: about.pipeline.clone(),
            seed: about.seed,
            device: about.device.clone(),
            inputs: external.collect(),
            stages: planned.iter().map(pending).collect(),
        }
    }
}

impl StageState {
    fn done(record: &StageRecord) -> Self {
        Self { fingerprint: record.fingerprint.clone(), status: StageStatus::Done, outputs: record.outputs.clone() }
    }
}
