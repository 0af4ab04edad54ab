//! Keeps trained models when their stage runs again: they are moved aside, and long trainings are repeated only on
//! request.

use super::earlier::Earlier;
use super::failure::{Failure, Result};
use super::kind::StageKind;
use super::record::StageRecord;
use crate::store::write_json_atomically;
use std::path::Path;

/// Training that took longer than this is repeated only on request, seconds.
const PRECIOUS_S: f64 = 600.0;
/// The file in which training keeps its state: a folder with it has a training that began.
const STATE_FILE: &str = "state.safetensors";
/// Separates the name of an output that is moved aside from the fingerprint of its record.
const EARLIER: &str = ".earlier-";
/// The record of the stage of a model that was moved aside.
const RECORD_FILE: &str = "record.json";

/// An output that is moved aside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kept {
    /// Its former name in the output folder.
    pub name: String,
    /// Its new name.
    pub as_name: String,
}

/// Decides what happens to trained models that running a stage would replace.
///
/// # Errors
/// When a long training would be repeated although it was requested neither by `is_requested` nor by a setting of the
/// stage's own section.
pub(super) fn kept(
    root: &Path,
    earlier: &Earlier,
    expected: &StageRecord,
    why: &str,
    is_requested: bool,
) -> Result<Vec<Kept>> {
    let Some(done) = earlier.done.as_ref().filter(|_| earlier.stage.trains) else { return Ok(Vec::new()) };
    let there: Vec<&String> = done.outputs.keys().filter(|name| root.join(name).is_dir()).collect();
    if done.summary["trained"] != true || there.is_empty() {
        return Ok(Vec::new());
    }
    let seconds = earlier.seconds_spent;
    if !is_requested && !expected.section_differs(done) && seconds.is_none_or(|seconds| seconds > PRECIOUS_S) {
        return Err(refusal(root, earlier.stage, why, seconds));
    }
    let kept = |name: &String| {
        let as_name = free_name(root, &format!("{name}{EARLIER}{}", done.short_fingerprint()));
        Kept { name: name.clone(), as_name }
    };
    Ok(there.into_iter().map(kept).collect())
}

fn refusal(root: &Path, stage: &StageKind, why: &str, seconds: Option<f64>) -> Failure {
    let cost =
        seconds.map_or_else(String::new, |seconds| format!(", which took {:.1} hours to train", seconds / 3600.0));
    let message = format!(
        "stage {stage} would retrain ({why}) and replace the model in {}{cost}; nothing was changed",
        root.display()
    );
    let redo = format!("--redo {stage}");
    Failure::input_message(message).with_hint(format!(
        "add {redo} to retrain (the old model is moved aside), undo the change, or copy the model elsewhere and use it \
         with {}.checkpoint",
        stage.section
    ))
}

/// Writes the record of its stage beside a model that was moved to `dir`.
pub(super) fn leave_record(earlier: &StageRecord, dir: &Path) -> Result<()> {
    let path = dir.join(RECORD_FILE);
    if !path.exists() {
        write_json_atomically(&path, earlier)?;
    }
    Ok(())
}

/// Moves unfinished trainings from the folder `dir` into `root`, under names that tell so.
pub(super) fn keep_unfinished(started: &StageRecord, dir: &Path, root: &Path) -> Result<()> {
    for entry in fs_err::read_dir(dir)? {
        let entry = entry?;
        if !entry.file_type()?.is_dir() || !entry.path().join(STATE_FILE).is_file() {
            continue;
        }
        let name = entry.file_name().to_string_lossy().into_owned();
        leave_record(started, &entry.path())?;
        let as_name = free_name(root, &format!("{name}.unfinished-{}", started.short_fingerprint()));
        fs_err::rename(entry.path(), root.join(as_name))?;
    }
    Ok(())
}

/// Whether an output named `name` may be kept under the name `as_name`.
pub(super) fn is_kept(name: &str, as_name: &str) -> bool {
    let number = as_name.strip_prefix(name).and_then(|rest| rest.strip_prefix(EARLIER));
    number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_hexdigit() || byte == b'-'))
}

/// The name, with the first number appended that makes it free, if it is taken.
fn free_name(root: &Path, name: &str) -> String {
    let is_free = |name: &str| root.join(name).symlink_metadata().is_err();
    let numbered = (2..).map(|n: u32| format!("{name}-{n}"));
    std::iter::once(name.to_owned()).chain(numbered).find(|name| is_free(name)).unwrap_or_else(|| name.to_owned())
}
