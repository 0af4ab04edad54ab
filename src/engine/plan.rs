//! Decides which stages must run, and which are reused or resumed.

use super::failure::{Blame, Failure, Result};
use super::fingerprint::{PathFingerprint, fingerprint_to};
use super::kept_models::{Kept, kept};
use super::kind::StageKind;
use super::outdated;
use super::ownership;
use super::record::{InputRecord, StageRecord};
use super::shards;
use super::stage::{Stage, StageInput};
use super::timings::times_seen;
use super::work_folder::WorkFolder;
use crate::cloud::Recordings;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

/// A stage with its action.
pub struct PlannedStage<'a> {
    /// The stage.
    pub stage: Box<dyn Stage + 'a>,
    /// The record that a run of it would have.
    pub expected: StageRecord,
    /// The action to take.
    pub action: Action,
    /// Whether it was done before, with other settings or inputs.
    pub is_redone: bool,
    /// Trained models that are moved aside for new ones.
    pub kept: Vec<Kept>,
    /// Whether it may run: the user selected it, or selected nothing.
    pub is_selected: bool,
    /// Whether it is to be done again even if it is up to date.
    pub is_requested: bool,
}

impl PlannedStage<'_> {
    /// For a stage that is done again: why, and what happens to its earlier results.
    pub fn redone(&self) -> Option<String> {
        let Action::Run(why) = &self.action else { return None };
        let kept = self.kept.iter().map(|Kept { name, as_name }| format!("; the current {name} is moved to {as_name}"));
        self.is_redone.then(|| format!("{} runs again: {why}{}", self.expected.stage, kept.collect::<String>()))
    }
}

/// The action for a stage.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Nothing: its outputs exist, from the same configuration and inputs.
    Reuse,
    /// Continue an interrupted run.
    Resume,
    /// Run it from the start, for this reason.
    Run(String),
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reuse => f.write_str("cached"),
            Self::Resume => f.write_str("fresh (resumes an interrupted run)"),
            Self::Run(why) => write!(f, "fresh ({why})"),
        }
    }
}

/// Decides on every stage, in order; those in `redo` are done again even if they are up to date. `root` is the folder
/// in which they write. Reads recordings to fingerprint them, and writes nothing.
///
/// # Errors
/// When a section is invalid, an input is missing, an output overlaps an input or holds files that the stage did not
/// write, or a trained model would be replaced without a request.
pub fn plan<'a>(
    root: &Path,
    kinds: &'static [StageKind],
    stages: Vec<Box<dyn Stage + 'a>>,
    redo: &[&'static StageKind],
) -> Result<Vec<PlannedStage<'a>>> {
    // All sections are checked before recordings are read, so that mistakes are found at once.
    stages.iter().try_for_each(|stage| stage.check())?;
    if let Some(stage) = redo.iter().find(|kind| !stages.iter().any(|stage| stage.kind() == **kind)) {
        return Err(Failure::input_message(format_args!("--redo {stage}: the pipeline has no such stage")));
    }
    ownership::check_overlaps(root, &stages)?;
    ownership::check_root(root, kinds)?;
    let mut planned: Vec<PlannedStage<'a>> = Vec::new();
    for stage in stages {
        let earlier = StageRecord::done(root, stage.kind())?;
        let (inputs, missing) = identify_inputs(root, &planned, stage.as_ref(), earlier.as_ref())?;
        let mut expected = StageRecord::expected(stage.as_ref(), inputs)?;
        // Work on the same contents keeps its fingerprint when files are moved, and so do later stages.
        let begun = begun(root, stage.kind())?;
        if let Some(same) = earlier.iter().chain(&begun).find(|earlier| expected.is_same_work(earlier)) {
            expected.fingerprint.clone_from(&same.fingerprint);
        }
        let is_requested = redo.contains(&stage.kind());
        let action = decide(root, stage.kind(), &mut expected, is_requested)?;
        if let Some(failure) = missing.filter(|_| action != Action::Reuse) {
            return Err(failure);
        }
        let is_redone = earlier.is_some();
        let kept = check_writable(root, stage.as_ref(), &expected, &action, is_requested)?;
        planned.push(PlannedStage { stage, expected, action, is_redone, kept, is_selected: true, is_requested });
    }
    Ok(planned)
}

/// The inputs of a stage, by name. If recordings were removed, their record from an earlier run replaces them, and the
/// second value is the failure to find them.
fn identify_inputs(
    root: &Path,
    planned: &[PlannedStage<'_>],
    stage: &dyn Stage,
    earlier: Option<&StageRecord>,
) -> Result<(BTreeMap<String, InputRecord>, Option<Failure>)> {
    let (mut inputs, mut missing) = (BTreeMap::new(), None);
    for input in stage.inputs() {
        let record = match identify(root, planned, &input, earlier) {
            Ok(record) => record,
            // Results stay valid when their recordings are removed.
            Err(failure) if failure.blame != Blame::Input => return Err(failure),
            Err(failure) => match earlier.and_then(|earlier| earlier.missing_input(&input)) {
                Some(record) => {
                    missing.get_or_insert(failure);
                    record
                }
                None => return Err(failure),
            },
        };
        inputs.insert(input.name, record);
    }
    Ok((inputs, missing))
}

/// Checks that a stage with this action overwrites no foreign files. Returns the trained models to keep.
pub(super) fn check_writable(
    root: &Path,
    stage: &dyn Stage,
    expected: &StageRecord,
    action: &Action,
    is_requested: bool,
) -> Result<Vec<Kept>> {
    match action {
        Action::Reuse => Ok(Vec::new()),
        // The user who began the training has requested it already.
        Action::Resume => {
            WorkFolder::check_ours(root, stage.kind())?;
            ownership::check_outputs(root, stage.kind(), stage.outputs())?;
            kept(root, stage.kind(), expected, "", true)
        }
        Action::Run(why) => {
            WorkFolder::check_ours(root, stage.kind())?;
            ownership::check_outputs(root, stage.kind(), stage.outputs())?;
            kept(root, stage.kind(), expected, why, is_requested)
        }
    }
}

/// The planned stages that are `selected`, and the finished ones before them.
///
/// # Errors
/// When a selected stage is not in the pipeline, or reads from one that is neither done nor selected
/// (`Blame::Later`).
pub fn select<'a>(planned: Vec<PlannedStage<'a>>, selected: &[&'static StageKind]) -> Result<Vec<PlannedStage<'a>>> {
    if let Some(stage) = selected.iter().find(|kind| !planned.iter().any(|planned| planned.stage.kind() == **kind)) {
        return Err(Failure::input_message(format_args!("--stage {stage}: the pipeline has no such stage")));
    }
    let is_ready =
        |planned: &PlannedStage<'_>| planned.action == Action::Reuse || selected.contains(&planned.stage.kind());
    for PlannedStage { stage, .. } in planned.iter().filter(|planned| selected.contains(&planned.stage.kind())) {
        let producers: Vec<&StageKind> = stage.inputs().iter().filter_map(|input| input.producer).collect();
        let waits_for = planned.iter().find(|other| producers.contains(&other.stage.kind()) && !is_ready(other));
        if let Some(PlannedStage { expected, action, .. }) = waits_for {
            let producer = &expected.stage;
            return Err(Failure::later(format_args!("stage {} waits for stage {producer}: {action}", stage.kind()))
                .with_hint(format!("run --stage {producer} first; this command can be repeated until then")));
        }
    }
    let marked = planned.into_iter().filter(is_ready).map(|planned| {
        let is_selected = selected.contains(&planned.stage.kind());
        PlannedStage { is_selected, ..planned }
    });
    Ok(marked.collect())
}

/// The record that `stage` would have if it ran alone in the folder `root`.
pub(super) fn expected(root: &Path, stage: &dyn Stage) -> Result<StageRecord> {
    let inputs = stage.inputs().into_iter().map(|input| Ok((input.name.clone(), identify(root, &[], &input, None)?)));
    StageRecord::expected(stage, inputs.collect::<Result<_>>()?)
}

/// The record of unfinished work on a stage in `root`, if there is any.
pub fn begun(root: &Path, stage: &'static StageKind) -> Result<Option<StageRecord>> {
    let started = WorkFolder::started(root, stage)?;
    started.map_or_else(|| shards::begun(root, stage), |started| Ok(Some(started)))
}

/// The identity of a stage's input: a fingerprint of the stage that makes it, or of its content.
///
/// `earlier` is the record of the stage's last run, which knows the former content of the same files.
fn identify(
    root: &Path,
    planned: &[PlannedStage<'_>],
    input: &StageInput,
    earlier: Option<&StageRecord>,
) -> Result<InputRecord> {
    if let Some(producer) = input.producer {
        let folder = input.path.parent().unwrap_or(Path::new("."));
        let here = planned.iter().find(|other| other.stage.kind() == producer && folder == root);
        let done =
            StageRecord::done(folder, producer)?.filter(|_| here.is_none_or(|here| here.action == Action::Reuse));
        let content = done.as_ref().and_then(StageRecord::content);
        let fingerprint =
            here.map(|here| here.expected.fingerprint.clone()).or_else(|| done.map(|record| record.fingerprint));
        if let Some(fingerprint) = fingerprint {
            return Ok(InputRecord::Stage { producer: producer.name.to_owned(), fingerprint, content });
        }
    }
    let known = earlier.and_then(|earlier| earlier.known_content(&input.name, &input.path));
    let content = fingerprint_input(&input.path, known).map_err(|failure| {
        let failure = failure.context(format!("failed to read the input {}", input.name));
        match input.producer {
            Some(producer) => failure
                .with_hint(format!("`djinn {}` writes it; see --help for how to use another path", producer.command)),
            None => failure.with_hint(
                "relative paths are relative to the pipeline file, those of the command line to the current directory",
            ),
        }
    })?;
    Ok(InputRecord::Path { path: input.path.clone(), content })
}

/// The fingerprint of an input from outside. Objects that have not changed since `known` are not downloaded.
fn fingerprint_input(path: &Path, known: Option<&PathFingerprint>) -> Result<PathFingerprint> {
    let Some(recordings) = Recordings::at(path)? else {
        return fingerprint_to(path, None, known).map_err(Failure::input);
    };
    let tag = Some(recordings.tag());
    if let Some(known) = known.filter(|known| known.times == tag) {
        return Ok(known.clone());
    }
    let content = fingerprint_to(&recordings.on_disk()?, None, None).map_err(Failure::input)?;
    Ok(PathFingerprint { times: tag, ..content })
}

/// The action for a stage. If it is reused, `expected` gets the times at which its outputs were last verified.
fn decide(root: &Path, stage: &'static StageKind, expected: &mut StageRecord, is_requested: bool) -> Result<Action> {
    let (done, begun) = (StageRecord::done(root, stage)?, begun(root, stage)?);
    let why = match &done {
        Some(_) if is_requested || shards::is_redone(root, stage)? => "requested by --redo".to_owned(),
        Some(done) if done.fingerprint != expected.fingerprint => expected.changes_since(stage, done),
        Some(done) => match done.check_outputs(root, &times_seen(root, stage))? {
            Err(name) => format!("{name} is missing or was changed"),
            Ok(times) => {
                expected.times = times;
                match expected.rewritten_since(done) {
                    Some(producer) if !outdated::is_kept(stage, done) => outdated::why(producer),
                    _ => return Ok(Action::Reuse),
                }
            }
        },
        None => match &begun {
            Some(started) if started.fingerprint != expected.fingerprint => expected.changes_since(stage, started),
            _ => "not done yet".to_owned(),
        },
    };
    Ok(match begun {
        Some(begun) if outdated::can_resume(expected, &begun) => Action::Resume,
        _ => Action::Run(why),
    })
}
