//! The progress of a run, judged from its folder alone.

use super::layout::Layout;
use super::{KINDS, StageId};
use crate::engine::begun;
use crate::engine::run_folder::{RUN_FILE, RunManifest};
use crate::engine::shards::{ShardStatus, shard_status};
use crate::engine::{Failure, Result, done_path, work_path};
use crate::store::read_json;
use crate::train::FitStatistics;
use serde::Serialize;
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// The progress of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Status {
    /// The stages that it has or will have, as far as they are known.
    pub stages: Vec<StageProgress>,
    /// The shards of the stage at which workers are, if any.
    pub shards: Option<ShardStatus>,
}

/// The progress of a stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageProgress {
    /// The stage.
    pub stage: StageId,
    /// Its state, as far as it can be known.
    pub state: ProgressState,
    /// For a training, the steps in its statistics.
    pub steps: Option<u64>,
    /// Steps in all.
    pub of_steps: Option<u64>,
}

/// The state of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProgressState {
    /// Its outputs are whole.
    Done,
    /// It was begun, and is at work or was interrupted.
    Begun,
    /// It was not begun.
    Missing,
}

/// Reads the progress from the run folder `root`.
///
/// # Errors
/// When it is not a run folder; errors of the file system.
pub fn status(root: &Path) -> Result<Status> {
    let manifest: Option<RunManifest> = read_json(&root.join(RUN_FILE)).ok();
    let shards = shard_status(root, &KINDS)?;
    let mut stages = Vec::new();
    for stage in StageId::ALL {
        let is_planned = manifest.as_ref().is_some_and(|manifest| manifest.stages.contains_key(stage.name()));
        let begun = begun(root, stage.kind())?;
        let is_in_parts = shards.as_ref().is_some_and(|shards| shards.stage == stage.name());
        let state = match () {
            () if begun.is_some() || is_in_parts => ProgressState::Begun,
            () if done_path(root, stage.kind()).is_file() => ProgressState::Done,
            () if is_planned => ProgressState::Missing,
            () => continue,
        };
        let steps = begun.as_ref().and_then(|_| steps(root, stage));
        let of_steps = begun.filter(|_| stage.kind().trains).and_then(|begun| steps_in_all(&begun.config));
        stages.push(StageProgress { stage, state, steps, of_steps });
    }
    if stages.is_empty() {
        return Err(Failure::input_message(format_args!("{} is not a run folder", root.display()))
            .with_hint("`djinn run` and `djinn submit` print the folder of their results"));
    }
    Ok(Status { stages, shards })
}

/// The total steps of a training with this section, which a preset may decide.
pub(super) fn steps_in_all(section: &Value) -> Option<u64> {
    // A training that is given time chooses them.
    if section.get("for").is_some_and(Value::is_string) {
        return None;
    }
    ["/resolved/fit/steps", "/steps"].iter().find_map(|key| section.pointer(key)?.as_u64())
}

/// The last step in the statistics of a training at work.
fn steps(root: &Path, stage: StageId) -> Option<u64> {
    let layout = Layout::below(root);
    let (_, place) = stage.output(&layout).filter(|_| stage.kind().trains)?;
    let folder = work_path(root, stage.kind()).join(place.file_name()?);
    let text = fs_err::read_to_string(folder.join("statistics.jsonl")).ok()?;
    let last: FitStatistics = serde_json::from_str(text.lines().last()?).ok()?;
    Some(last.step)
}

impl Status {
    /// The status as lines for people.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for StageProgress { stage, state, steps, of_steps } in &self.stages {
            let state = match state {
                ProgressState::Done => "done".to_owned(),
                ProgressState::Missing => "not begun".to_owned(),
                ProgressState::Begun => match (steps, of_steps) {
                    (Some(steps), Some(of)) => format!("begun, {steps} of {of} steps"),
                    (Some(steps), None) => format!("begun, {steps} steps"),
                    _ => "begun".to_owned(),
                },
            };
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{:<18}{state}", stage.name());
        }
        self.shards.iter().for_each(|shards| text.push_str(&shards.text()));
        text
    }
}
