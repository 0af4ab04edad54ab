//! `<stage>.parts/<plan-id>/`: the plan, and the shards that workers have finished, each with a record beside it.
//!
//! The plan's id is in the path, so that a worker of a discarded plan cannot write into another one.

use super::division::Division;
use super::identity::Identity;
use super::plan_files::{ABOUT_FILE, LOG, PLAN_FILE, discard, plan_dirs, plans_of};
use super::tries::{MAX_TRIES, Tries};
use crate::engine::{Failure, Result, ShardNames, StageKind};
use crate::files::{FileStamp, files_below, remove_if_present};
use crate::store::{self, read_record, write_record};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of a plan.
#[derive(Debug, Clone)]
pub(crate) struct ShardFolder {
    dir: PathBuf,
    kind: &'static StageKind,
    names: ShardNames,
    about: About,
}

/// Facts about a plan, known without reading it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct About {
    /// The identity that its workers share.
    #[serde(flatten)]
    identity: Identity,
    n_shards: usize,
    /// Whether it was made for several workers. No other process knows of a plan that a process made for itself, so
    /// that one is discarded without asking.
    is_shared: bool,
    /// Whether the stage was requested to be done again, so that finished work with the same settings does not make the
    /// plan needless.
    redoes: bool,
}

/// The record of a finished shard; written beside the shard, after it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct FinishedShard<S> {
    pub(super) plan_id: String,
    pub(super) worker: String,
    /// The time it took, seconds.
    pub(super) seconds: f64,
    /// Size and hash of its file.
    pub(super) stamp: FileStamp,
    /// Facts that the stage needs later.
    pub(super) facts: S,
}

impl ShardFolder {
    /// The plans of a stage in a run folder; incomplete plans do not count.
    pub(in crate::engine) fn all(root: &Path, kind: &'static StageKind) -> Result<Vec<Self>> {
        let Some(names) = kind.shards else { return Ok(Vec::new()) };
        let mut found = Vec::new();
        for dir in plan_dirs(root, kind)? {
            let about = read_record(&dir.join(ABOUT_FILE)).map_err(|error| damaged(error, &dir))?;
            found.extend(about.map(|about| Self { dir, kind, names, about }));
        }
        Ok(found)
    }

    /// Removes the remains of plans that a killed process had not finished writing or removing.
    pub(super) fn remove_remains(root: &Path, kind: &'static StageKind) -> Result<()> {
        let Some(names) = kind.shards else { return Ok(()) };
        let remains = plan_dirs(root, kind)?.into_iter().filter(|dir| !dir.join(ABOUT_FILE).exists());
        remains.into_iter().try_for_each(|dir| discard(&dir, names))
    }

    /// The plan for processes of this `identity`, if there is one.
    ///
    /// When there are only plans of other identities; errors of the file system.
    pub(super) fn of(root: &Path, kind: &'static StageKind, identity: &Identity) -> Result<Option<Self>> {
        let mut differs = None;
        for folder in Self::all(root, kind)? {
            match folder.difference(identity) {
                None => return Ok(Some(folder)),
                Some(difference) => differs = Some(folder.refusal(&difference)),
            }
        }
        differs.map_or(Ok(None), Err)
    }

    /// Keeps a plan, which no other process may use yet.
    pub(super) fn write(
        root: &Path,
        kind: &'static StageKind,
        identity: Identity,
        division: &Division,
    ) -> Result<Self> {
        let names = kind.shards;
        let names = names.ok_or_else(|| Failure::fault(anyhow::anyhow!("stage {kind} has no shards")))?;
        let dir = plans_of(root, kind).join(identity.plan_id()?);
        let folder = Self {
            dir,
            kind,
            names,
            about: About { identity, n_shards: division.n_shards, is_shared: false, redoes: false },
        };
        // The remains of a killed process have no plan, so no worker has used them.
        folder.discard()?;
        fs_err::create_dir_all(&folder.dir)?;
        write_record(&folder.dir.join(PLAN_FILE), &division.decisions)?;
        write_record(&folder.dir.join(ABOUT_FILE), &folder.about)?;
        Ok(folder)
    }

    /// Lets several workers use the plan. `redoes` is whether the stage was requested to be done again, now or before.
    pub(super) fn shared(mut self, redoes: bool) -> Result<Self> {
        self.about.is_shared = true;
        self.about.redoes |= redoes;
        write_record(&self.dir.join(ABOUT_FILE), &self.about)?;
        Ok(self)
    }

    /// Whether several workers may use the plan.
    pub(super) fn is_shared(&self) -> bool {
        self.about.is_shared
    }

    /// Whether the stage was requested to be done again.
    pub(in crate::engine) fn redoes(&self) -> bool {
        self.about.redoes
    }

    /// The decisions made before any shard.
    pub(super) fn decisions<P: DeserializeOwned>(&self) -> Result<P> {
        let path = self.dir.join(PLAN_FILE);
        let plan = read_record(&path).map_err(|error| damaged(error, &self.dir))?;
        plan.ok_or_else(|| Failure::fault(anyhow::anyhow!("{} is missing", path.display())))
    }

    /// Whether the plan still exists: nobody has sealed or discarded it.
    pub(super) fn is_there(&self) -> bool {
        self.dir.join(ABOUT_FILE).exists()
    }

    /// The difference between the plan and a process of this identity; `None` if they fit together.
    pub(super) fn difference(&self, own: &Identity) -> Option<String> {
        own.difference(self.kind, self.identity())
    }

    /// The identity that its workers share.
    pub(in crate::engine) fn identity(&self) -> &Identity {
        &self.about.identity
    }

    /// Number of shards that were known from the start.
    pub(super) fn n_planned(&self) -> usize {
        self.about.n_shards
    }

    /// Number of shards in the plan, or begun since.
    pub(super) fn n_shards(&self) -> Result<usize> {
        let after = |name: PathBuf| {
            let (shard, _) = name.to_str()?.strip_prefix(self.names.shard)?.strip_prefix('-')?.split_once('.')?;
            Some(shard.parse::<usize>().ok()? + 1)
        };
        let begun = files_below(&self.dir)?.into_iter().filter_map(after).max();
        Ok(begun.unwrap_or_default().max(self.about.n_shards))
    }

    /// The error of a process that differs from the plan in this way.
    pub(super) fn refusal(&self, difference: &str) -> Failure {
        // An unreadable folder does not matter here: the refusal is the message.
        let n_shards = self.n_shards().unwrap_or_default();
        let n_finished = (0..n_shards).filter(|idx| self.sidecar(*idx).exists()).count();
        self.identity().refusal(self.kind, difference, (n_finished, n_shards))
    }

    pub(super) fn dir(&self) -> &Path {
        &self.dir
    }

    pub(super) fn log(&self, worker: usize) -> PathBuf {
        self.dir.join(format!("{LOG}{worker:05}.txt"))
    }

    pub(super) fn shard_name(&self, idx: usize) -> String {
        self.names.shard_name(idx)
    }

    pub(super) fn file_name(&self, idx: usize) -> String {
        format!("{}.{}", self.shard_name(idx), self.names.ending)
    }

    /// The record of shard `idx`, if it is finished. Its content is verified when it is published.
    pub(super) fn finished<S: DeserializeOwned>(&self, idx: usize) -> Option<FinishedShard<S>> {
        // A damaged record counts for nothing: the shard is made again.
        let shard: FinishedShard<S> = read_record(&self.sidecar(idx)).ok()??;
        let n_bytes = fs_err::metadata(self.dir.join(self.file_name(idx))).ok()?.len();
        let is_whole = n_bytes == shard.stamp.n_bytes;
        (is_whole && self.dir.ends_with(&shard.plan_id)).then_some(shard)
    }

    /// The time that shard `idx` took, if it is finished, seconds.
    pub(super) fn seconds(&self, idx: usize) -> Option<f64> {
        self.finished::<IgnoredAny>(idx).map(|shard| shard.seconds)
    }

    /// Declares a shard finished; its file must be complete.
    pub(super) fn finish<S: Serialize>(
        &self,
        idx: usize,
        (worker, seconds): (&str, f64),
        (stamp, facts): (FileStamp, S),
    ) -> Result<()> {
        let plan_id = self.dir.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let shard = FinishedShard { plan_id, worker: worker.to_owned(), seconds, stamp, facts };
        write_record(&self.sidecar(idx), &shard)?;
        Ok(())
    }

    /// Compares the content of a finished shard with its checksum. A damaged shard no longer counts as finished.
    ///
    /// # Errors
    /// On I/O errors: a shard that cannot be read now is not considered damaged.
    pub(super) fn verified<S: DeserializeOwned>(&self, idx: usize) -> Result<Option<FinishedShard<S>>> {
        let Some(shard) = self.finished::<S>(idx) else { return Ok(None) };
        if shard.stamp.is_of(&self.dir.join(self.file_name(idx)))? {
            return Ok(Some(shard));
        }
        remove_if_present(&self.sidecar(idx))?;
        Ok(None)
    }

    /// Makes sure that damaged or failed shards are made again: removes the marks of failed tries and, if nobody else
    /// can be at work, all marks.
    pub(super) fn forget_failures(&self) -> Result<()> {
        for idx in 0..self.n_shards()? {
            self.verified::<IgnoredAny>(idx)?;
        }
        for name in self.tried()? {
            let Some(idx) = name.strip_prefix(self.names.shard).and_then(|rest| rest.strip_prefix('-')?.parse().ok())
            else {
                continue;
            };
            if !self.is_shared() || !self.tries(idx).failed.is_empty() {
                self.try_paths(idx).try_for_each(|path| remove_if_present(&path))?;
            }
        }
        Ok(())
    }

    /// Removes the plan and everything that workers wrote for it. Workers that are still running find no plan.
    pub(super) fn discard(&self) -> Result<()> {
        discard(&self.dir, self.names)
    }

    /// The names of shards that were tried and are not finished. Reads the folder's list once: on a network file system
    /// that is faster than looking for many missing files.
    pub(super) fn tried(&self) -> Result<BTreeSet<String>> {
        let names = files_below(&self.dir)?;
        let shard_of = |name: &PathBuf| Some(name.to_str()?.split_once(".try-")?.0.to_owned());
        Ok(names.iter().filter_map(shard_of).collect())
    }

    /// Appends the workers' logs to the log at `path`.
    pub(super) fn append_logs(&self, path: &Path) -> Result<()> {
        let mut text = String::new();
        for name in files_below(&self.dir)? {
            let file = name.to_string_lossy();
            if let Some(worker) = file.strip_prefix(LOG).and_then(|rest| rest.strip_suffix(".txt")) {
                let lines = fs_err::read_to_string(self.dir.join(&name))?;
                lines.lines().for_each(|line| text.push_str(&format!("worker {worker}: {line}\n")));
            }
        }
        Ok(fs_err::File::options().create(true).append(true).open(path)?.write_all(text.as_bytes())?)
    }

    fn sidecar(&self, idx: usize) -> PathBuf {
        self.dir.join(format!("{}.json", self.shard_name(idx)))
    }

    /// The path of the mark of the `number`-th try at a shard.
    pub(super) fn try_path(&self, idx: usize, number: usize) -> PathBuf {
        self.dir.join(format!("{}.try-{number}", self.shard_name(idx)))
    }

    /// The paths of the marks of all tries at a shard.
    pub(super) fn try_paths(&self, idx: usize) -> impl Iterator<Item = PathBuf> + Clone {
        (1..=MAX_TRIES).map(move |number| self.try_path(idx, number))
    }

    pub(super) fn tries(&self, idx: usize) -> Tries {
        Tries::of(self.try_paths(idx))
    }
}

/// The failure to read a record in the folder of a plan.
fn damaged(error: store::Error, dir: &Path) -> Failure {
    Failure::unreadable(error, || format!("move {} away, and plan again", dir.display()))
}
