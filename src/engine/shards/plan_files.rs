//! Which folders and files belong to the plans of a stage?

use super::tries::is_try_of;
use crate::engine::{Failure, Result, ShardNames, StageKind};
use crate::files::{self, files_below, foreign, is_link, remove_if_present, remove_listed};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

pub(super) const PLAN_FILE: &str = "plan.json";
/// Written after the plan: its presence means that workers may begin.
pub(super) const ABOUT_FILE: &str = "parts.json";

/// The prefix of the names of workers' logs, before that of the worker.
pub(super) const LOG: &str = "worker-";

/// The folders of the plans of a stage, in order, complete or not.
pub(super) fn plan_dirs(root: &Path, kind: &'static StageKind) -> Result<Vec<PathBuf>> {
    let parts = plans_of(root, kind);
    if is_link(&parts) {
        return Err(files::Error::Link { path: parts }.into());
    }
    if !parts.is_dir() {
        return Ok(Vec::new());
    }
    let is_plan_id = |name: &str| name.len() == 16 && name.bytes().all(|byte| byte.is_ascii_hexdigit());
    let mut dirs = Vec::new();
    for entry in fs_err::read_dir(parts)? {
        let entry = entry?;
        // Systems leave files of their own in folders, and links lead anywhere.
        if entry.file_type()?.is_dir() && entry.file_name().to_str().is_some_and(is_plan_id) {
            dirs.push(entry.path());
        }
    }
    dirs.sort();
    Ok(dirs)
}

/// Removes a plan and everything that workers wrote for it.
pub(super) fn discard(dir: &Path, names: ShardNames) -> Result<()> {
    let found = files_below(dir)?;
    let ours: BTreeSet<PathBuf> = found.into_iter().filter(|name| is_ours(name, names)).collect();
    let theirs = foreign(dir, &ours)?;
    if !theirs.is_empty() {
        return Err(files::Error::Foreign { path: dir.to_owned(), found: theirs }.into());
    }
    // Processes read this first.
    remove_if_present(&dir.join(ABOUT_FILE))?;
    remove_listed(dir, &ours).map_err(Failure::fault)?;
    if let Some(parts) = dir.parent() {
        // Others may be in it.
        let _ = fs_err::remove_dir(parts);
    }
    Ok(())
}

/// Whether plans or workers write files with this name, or temporary files for them.
fn is_ours(name: &Path, names: ShardNames) -> bool {
    let name = name.to_string_lossy();
    let whole = name.strip_suffix(crate::files::PARTIAL_SUFFIX).and_then(|rest| rest.rsplit_once('.'));
    let name = whole.map_or(name.as_ref(), |(whole, _)| whole);
    let is_number = |text: &str| text.len() >= 5 && text.bytes().all(|byte| byte.is_ascii_digit());
    let is_log = || name.strip_prefix(LOG).and_then(|rest| rest.strip_suffix(".txt")).is_some_and(is_number);
    let is_shard = || {
        let (stem, ending) = name.split_once('.')?;
        let idx = stem.strip_prefix(names.shard)?.strip_prefix('-').filter(|idx| is_number(idx))?;
        let shard = names.shard_name(idx.parse().ok()?);
        ([names.ending, "json"].contains(&ending) || is_try_of(name, &shard)).then_some(())
    };
    [PLAN_FILE, ABOUT_FILE].contains(&name) || is_log() || is_shard().is_some() || (names.is_other)(name)
}

/// The folder of the plans of a stage, in the run folder.
pub(super) fn plans_of(root: &Path, kind: &'static StageKind) -> PathBuf {
    root.join(format!("{kind}.parts"))
}
