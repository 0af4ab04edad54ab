//! The folder in which a stage works, and the exchange of its outputs with earlier ones.
//!
//! A stage works in `<stage>.partial` in the output folder, which lists every file that is begun in it. Earlier outputs
//! stay in their places meanwhile. Once the new ones are complete, `done.json` is written in the work folder. From then
//! on they are put in place, at the latest when the folder is opened the next time ([`WorkFolder::complete_all`]).
//! Folders are exchanged by one system call if the system has one, so that each output, old or new, is always in place,
//! whenever the process is killed.

use super::failure::{Failure, Result};
use super::kept_models::{self, Kept};
use super::kind::StageKind;
use super::ownership;
use super::record::{StageRecord, done_path};
use crate::files::{
    self, Error, enter_all, exchange, keep_list, listed, remove_if_present, remove_leftovers, remove_listed,
    sync_folder, write_atomically,
};
use crate::store::{Error as StoreError, read_record, write_record};
use fs_err as fs;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The record of the stage at work.
const STARTED_FILE: &str = "started.json";
/// The record of the stage whose outputs are whole, but not all in place.
const DONE_FILE: &str = "done.json";
/// The names of earlier outputs to keep.
const KEEP_FILE: &str = "keep.json";
/// Marks a new folder during the exchange, to distinguish it from the one that it replaces.
const NEW_FILE: &str = ".djinn-new";
/// The folder of earlier outputs that were replaced and are about to be removed.
const REPLACED: &str = "replaced";

pub(super) struct WorkFolder {
    root: PathBuf,
    dir: PathBuf,
    stage: &'static StageKind,
}

/// Names under which earlier outputs stay in the output folder, by their former names.
#[derive(Debug, Default, Serialize, Deserialize)]
struct KeptNames {
    names: BTreeMap<String, String>,
}

/// The folder in which a stage works.
pub fn work_path(root: &Path, stage: &StageKind) -> PathBuf {
    root.join(format!("{stage}.partial"))
}

impl WorkFolder {
    fn of(root: &Path, stage: &'static StageKind) -> Self {
        Self { root: root.to_owned(), dir: work_path(root, stage), stage }
    }

    /// The record of a stage that was interrupted while at work in `root`, if there is one.
    pub(super) fn started(root: &Path, stage: &'static StageKind) -> Result<Option<StageRecord>> {
        let work = Self::of(root, stage);
        match work.record(STARTED_FILE)? {
            Some(record) => Ok(Some(record)),
            None => work.record(DONE_FILE),
        }
    }

    fn record(&self, name: &str) -> Result<Option<StageRecord>> {
        StageRecord::read(&self.dir.join(name), self.stage).map_err(|error| self.unreadable(error))
    }

    /// The names under which earlier outputs are kept.
    fn kept_names(&self) -> Result<BTreeMap<String, String>> {
        let path = self.dir.join(KEEP_FILE);
        let kept: Option<KeptNames> = read_record(&path).map_err(|error| self.unreadable(error))?;
        let names = kept.unwrap_or_default().names;
        let outputs = self.stage.outputs;
        let may_be = |(name, as_name): (&String, &String)| {
            outputs.contains(&name.as_str()) && kept_models::is_kept(name, as_name)
        };
        match names.iter().find(|names| !may_be(*names)) {
            Some((name, as_name)) => {
                let detail = format!("{name:?} cannot stay as {as_name:?}");
                Err(self.unreadable(StoreError::Record { path, detail }))
            }
            None => Ok(names),
        }
    }

    fn unreadable(&self, error: StoreError) -> Failure {
        let (dir, stage) = (self.dir.display(), self.stage);
        Failure::unreadable(error, || format!("restore it from a copy, or move {dir} away: then {stage} begins anew"))
    }

    /// Resumes the work that an interrupted run left.
    pub(super) fn resume(root: &Path, stage: &'static StageKind, expected: &StageRecord) -> Result<Self> {
        let work = Self::of(root, stage);
        if Self::started(root, stage)?.is_none() {
            work.discard()?;
            work.announce(expected)?;
        }
        remove_leftovers(&work.dir)?;
        Ok(work)
    }

    /// Begins anew, replacing the work that an interrupted run left.
    pub(super) fn begin(root: &Path, stage: &'static StageKind, expected: &StageRecord) -> Result<Self> {
        let work = Self::of(root, stage);
        work.discard()?;
        work.announce(expected)?;
        Ok(work)
    }

    /// The folder into which the stage writes.
    pub(super) fn path(&self) -> &Path {
        &self.dir
    }

    /// Declares the outputs whole and puts them in place. `kept` tells whether, and under which name, an existing
    /// trained model stays.
    pub(super) fn finish(
        &self,
        expected: StageRecord,
        outputs: &[&str],
        summary: Value,
        kept: &[Kept],
    ) -> Result<StageRecord> {
        remove_leftovers(&self.dir)?;
        let mut written = listed(&self.dir)?.unwrap_or_default();
        // Some files were begun and given up, or were temporary.
        written.retain(|name| self.dir.join(name).is_file());
        let record = expected.finished(&self.dir, outputs, &written, summary)?;
        let names = kept.iter().map(|kept| (kept.name.clone(), kept.as_name.clone())).collect();
        write_record(&self.dir.join(KEEP_FILE), &KeptNames { names })?;
        write_record(&self.dir.join(DONE_FILE), &record)?;
        self.publish(&record)?;
        Ok(record)
    }

    /// Finishes what earlier processes left unfinished: puts whole outputs in place, and removes what was about to be
    /// removed.
    pub(super) fn complete_all(root: &Path, kinds: &'static [StageKind]) -> Result<()> {
        for stage in kinds {
            let work = Self::of(root, stage);
            if let Some(record) = work.record(DONE_FILE)? {
                work.publish(&record)?;
            } else if listed(&work.dir)?.is_some() && !work.dir.join(STARTED_FILE).exists() {
                work.clean_up()?;
            }
        }
        Ok(())
    }

    /// Puts the outputs in place. A kill at any moment leaves a state from which the same steps go on.
    fn publish(&self, record: &StageRecord) -> Result<()> {
        // An output that is in place already is not examined: the record of the earlier run does not know it.
        let earlier = StageRecord::done(&self.root, self.stage)?;
        let waits = |name: &&String| self.dir.join(name).exists() && !self.root.join(name).join(NEW_FILE).exists();
        let names: Vec<&str> = record.outputs.keys().filter(waits).map(String::as_str).collect();
        ownership::check_outputs(&self.root, earlier.as_ref(), &names)?;
        ownership::check_work(&self.dir)?;
        let keep = self.kept_names()?;
        let replaced = earlier.iter().flat_map(|earlier| earlier.outputs.keys());
        let places = record.outputs.keys().chain(replaced).flat_map(|name| [self.dir.join(name), self.root.join(name)]);
        if let Some(path) = places.chain([self.dir.join(REPLACED)]).find(|place| files::is_link(place)) {
            return Err(Error::Link { path }.into());
        }
        remove_if_present(&self.dir.join(STARTED_FILE))?;
        for name in record.outputs.keys() {
            self.put_in_place(name, keep.get(name), earlier.as_ref())?;
        }
        if let Some(earlier) = &earlier {
            for away in keep.values().map(|as_name| self.root.join(as_name)) {
                if away.is_dir() && !files::is_link(&away) {
                    kept_models::leave_record(earlier, &away)?;
                }
            }
            self.remove_stale(earlier, record)?;
        }
        sync_folder(&self.root)?;
        fs::rename(self.dir.join(DONE_FILE), done_path(&self.root, self.stage))?;
        sync_folder(&self.root)?;
        self.clean_up()
    }

    /// Puts the output `name` in place. Files are renamed over earlier ones, folders are exchanged with them, so that
    /// there is always one or the other. The earlier one then gets the name under which it stays, or is put where it
    /// will be removed.
    fn put_in_place(&self, name: &str, as_name: Option<&String>, earlier: Option<&StageRecord>) -> Result<()> {
        let (new, place) = (self.dir.join(name), self.root.join(name));
        let away = as_name.map_or_else(|| self.dir.join(REPLACED).join(name), |as_name| self.root.join(as_name));
        let mark = place.join(NEW_FILE);
        if new.exists() && !mark.exists() {
            if new.is_dir() && place.is_dir() {
                self.list_replaced(name, earlier)?;
                // A kill while the mark was written left a part of it, which would be moved, too.
                remove_leftovers(&self.dir)?;
                write_atomically::<std::io::Error>(&new.join(NEW_FILE), |_| Ok(()))?;
                fs::create_dir_all(self.dir.join(REPLACED))?;
                if !exchange(&new, &place)? {
                    fs::rename(&place, &away)?;
                }
            }
            if !mark.exists() {
                fs::rename(&new, &place)?;
            }
        }
        if mark.exists() {
            if new.exists() {
                fs::rename(&new, &away)?;
            }
            fs::remove_file(mark)?;
        }
        Ok(())
    }

    /// Lists the files of an earlier output under the names that they will have in the work folder, so that they are
    /// known as ours whenever the process is killed.
    fn list_replaced(&self, name: &str, earlier: Option<&StageRecord>) -> Result<()> {
        let files = earlier.iter().flat_map(|earlier| &earlier.files).filter(|file| file.starts_with(name));
        let names: Vec<PathBuf> = files.flat_map(|file| [file.clone(), Path::new(REPLACED).join(file)]).collect();
        Ok(enter_all(&self.dir, names.iter().map(PathBuf::as_path))?)
    }

    /// Removes files that the earlier run wrote under names that this one did not write at all.
    fn remove_stale(&self, earlier: &StageRecord, record: &StageRecord) -> Result<()> {
        for name in earlier.outputs.keys().filter(|name| !record.outputs.contains_key(*name)) {
            let place = self.root.join(name);
            if place.is_dir() {
                remove_listed(&place, &earlier.files_below(name).collect())?;
            } else if earlier.files.contains(Path::new(name)) {
                remove_if_present(&place)?;
            }
        }
        Ok(())
    }

    fn announce(&self, expected: &StageRecord) -> Result<()> {
        fs::create_dir_all(&self.dir)?;
        keep_list(&self.dir)?;
        write_record(&self.dir.join(STARTED_FILE), expected)?;
        Ok(())
    }

    /// Makes room for new work. An unfinished training is moved aside: it may have cost hours.
    fn discard(&self) -> Result<()> {
        ownership::check_work(&self.dir)?;
        if let Some(started) = Self::started(&self.root, self.stage)?.filter(|_| self.stage.trains) {
            kept_models::keep_unfinished(&started, &self.dir, &self.root)?;
        }
        self.clean_up()
    }

    fn clean_up(&self) -> Result<()> {
        if let Some(ours) = listed(&self.dir)? {
            remove_listed(&self.dir, &ours)?;
        } else if self.dir.is_dir() {
            remove_listed(&self.dir, &BTreeSet::new())?;
        }
        Ok(())
    }
}
