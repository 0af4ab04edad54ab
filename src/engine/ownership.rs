//! May a command write into this folder, and which files in it are its own?

use super::failure::{Failure, Result};
use super::kind::StageKind;
use super::log::LOG_FILE;
use super::record::{StageRecord, done_path};
use super::timings::TIMINGS_FILE;
use crate::files::{Error, foreign, is_link, is_partial_of, listed, resolve};
use crate::store::{Error as StoreError, read_record};
use serde_json::Value;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Name of the resolved configuration in a run folder.
pub const CONFIG_FILE: &str = "config.toml";
/// Name of the run's manifest in a run folder.
pub const RUN_FILE: &str = "run.json";

/// Rejects a folder with a foreign file under a name that every command writes.
pub(super) fn check_root(root: &Path, kinds: &'static [StageKind]) -> Result<()> {
    if let Some(file) = root.ancestors().find(|path| path.exists()).filter(|path| !path.is_dir()) {
        let message = format!("{} is not a folder; output is written into a folder", file.display());
        return Err(Failure::input_message(message).with_hint("name another folder with --output"));
    }
    check_no_output(root, kinds)?;
    let mut found = Vec::new();
    let mut check = |name: &str, is_ours: &dyn Fn() -> bool| {
        let path = root.join(name);
        if path.symlink_metadata().is_ok() && (is_link(&path) || !is_ours()) {
            found.push(PathBuf::from(name));
        }
    };
    for name in [RUN_FILE, TIMINGS_FILE] {
        let is_ours = is_record(&root.join(name)).map_err(|error| {
            Failure::unreadable(error, || "move it away, and the same command writes it anew".to_owned())
        })?;
        check(name, &|| is_ours);
    }
    check(LOG_FILE, &|| is_log(root));
    // It is written after the manifest.
    check(CONFIG_FILE, &|| root.join(RUN_FILE).exists());
    for stage in kinds {
        let name = done_path(Path::new(""), stage).to_string_lossy().into_owned();
        let is_ours =
            is_record(&root.join(&name)).or_else(|_| StageRecord::done(root, stage).map(|done| done.is_some()))?;
        check(&name, &|| is_ours);
    }
    if found.is_empty() { Ok(()) } else { Err(Error::Foreign { path: root.to_owned(), found }.into()) }
}

/// Rejects a folder within an output of a finished stage: it would not be whole any more.
fn check_no_output(root: &Path, kinds: &'static [StageKind]) -> Result<()> {
    let root = resolve(root)?;
    for above in root.ancestors().skip(1) {
        for kind in kinds.iter().filter(|kind| done_path(above, kind).is_file()) {
            let within = root.strip_prefix(above).unwrap_or(&root);
            if let Some(output) = kind.outputs.iter().find(|output| within.starts_with(output)) {
                let message = format!("{} lies in {output}, an output of stage {kind}", root.display());
                return Err(Failure::input_message(message).with_hint("name another folder with --output"));
            }
        }
    }
    Ok(())
}

/// Whether lines may be added to the log in `root`: it is empty, was begun by a command of djinn, or lies beside other
/// files of djinn.
fn is_log(root: &Path) -> bool {
    const HEAD_BYTES: u64 = 4096;
    let mut head = Vec::new();
    let read = fs_err::File::open(root.join(LOG_FILE)).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    let first = String::from_utf8_lossy(head.split(|byte| *byte == b'\n').next().unwrap_or_default()).into_owned();
    let begins_as_ours = head.is_empty() || (first.contains(" djinn ") && first.contains(" begins in "));
    let is_ours = |name: &str| is_record(&root.join(name)).unwrap_or_default();
    (read.is_ok() && begins_as_ours) || is_ours(RUN_FILE) || is_ours(TIMINGS_FILE)
}

/// Whether a file is a record that a command wrote.
fn is_record(path: &Path) -> Result<bool, StoreError> {
    if !path.is_file() {
        return Ok(false);
    }
    let damage = match read_record::<Value>(path) {
        Ok(record) => return Ok(record.is_some()),
        Err(damage) => damage,
    };
    // No flipped bit hits both marks. A file with neither is foreign.
    let has = |mark: &str, bytes: &[u8]| bytes.windows(mark.len()).any(|window| window == mark.as_bytes());
    let is_like_ours = |bytes: Vec<u8>| has("\"stage", &bytes) || has("\"checksum\"", &bytes);
    match damage {
        StoreError::Record { .. } if !is_like_ours(fs_err::read(path)?) => Ok(false),
        damage => Err(damage),
    }
}

/// Removes half-written files that every command writes. The folder must be locked.
pub(super) fn remove_leftovers(root: &Path, kinds: &'static [StageKind]) -> Result<()> {
    let records: Vec<String> = kinds.iter().map(|stage| format!("{stage}.done.json")).collect();
    for entry in fs_err::read_dir(root)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let mut own = [CONFIG_FILE, RUN_FILE, TIMINGS_FILE].into_iter().chain(records.iter().map(String::as_str));
        if entry.file_type()?.is_file() && own.any(|own| is_partial_of(&name, own)) {
            fs_err::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Rejects the outputs of a stage if their places hold anything that it did not write, by its record `done`.
pub(super) fn check_outputs(root: &Path, done: Option<&StageRecord>, outputs: &[&str]) -> Result<()> {
    for name in outputs {
        let place = root.join(name);
        if place.symlink_metadata().is_err() {
            continue;
        }
        if is_link(&place) {
            return Err(Error::Link { path: place }.into());
        }
        let found = match place.is_dir() {
            true => foreign(&place, &done.map(|done| done.files_below(name).collect()).unwrap_or_default())?,
            false if done.is_some_and(|done| done.files.contains(Path::new(name))) => Vec::new(),
            false => vec![PathBuf::from(name)],
        };
        if !found.is_empty() {
            return Err(Error::Foreign { path: place, found }.into());
        }
    }
    Ok(())
}

/// Rejects a folder for work that holds foreign files.
pub(super) fn check_work(dir: &Path) -> Result<()> {
    let path = dir.to_owned();
    if is_link(&path) {
        return Err(Error::Link { path }.into());
    }
    let found = match path.is_file() {
        true => path.file_name().map(PathBuf::from).into_iter().collect(),
        false => foreign(&path, &listed(&path)?.unwrap_or_default())?,
    };
    if found.is_empty() { Ok(()) } else { Err(Error::Foreign { path, found }.into()) }
}
