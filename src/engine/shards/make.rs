//! Makes shards, in any number of processes.

use super::folder::ShardFolder;
use super::identity::Identity;
use super::open;
use super::tries;
use crate::engine::inputs::{check_inputs, expected};
use crate::engine::log::Logged;
use crate::engine::stage::{Stage, Work};
use crate::engine::{Blame, ComputeChoice, Failure, Result, StageRecord};
use crate::files::{FileStamp, remove_if_present};
use crate::progress::Progress;
use crate::settings::Unreadable;
use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

/// The shortest wait for shards of other workers, and the wait while no time of a shard is known.
pub(super) const LEAST_PATIENCE: Duration = Duration::from_secs(2);
const UNKNOWN: Duration = Duration::from_secs(10);
/// The time between looking for shards of other workers.
const POLL: Duration = Duration::from_millis(200);

/// The number of a worker. Several may share one: it only decides where they begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Worker {
    /// Its number, from 1.
    number: usize,
    of: usize,
}

impl FromStr for Worker {
    type Err = Unreadable;

    fn from_str(text: &str) -> Result<Self, Unreadable> {
        let read = || {
            let (number, of) = text.split_once('/')?;
            Some(Self { number: number.parse().ok()?, of: of.parse().ok()? })
        };
        let worker = read().filter(|worker| worker.number <= worker.of && (1..=100_000).contains(&worker.of));
        // Engines that count from 0 pass 0 in place of the last number.
        let counted = worker.map(|Self { number, of }| Self { number: if number == 0 { of } else { number }, of });
        counted.ok_or_else(|| "expected K/N with K from 1 to N, or from 0 to N - 1, such as 3/100".into())
    }
}

impl fmt::Display for Worker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Worker {
    /// The only worker.
    pub(super) const ALONE: Self = Self { number: 1, of: 1 };

    /// The order in which this worker takes the shards: its own first, then those of other workers from the end
    /// backward, because those are reached last. Every worker starts at a different shard, so that they do not all take
    /// the same one.
    pub(super) fn order(self, n_shards: usize) -> impl Iterator<Item = usize> {
        let own = (self.number - 1..n_shards).step_by(self.of);
        let others = move || (0..n_shards).rev().filter(move |idx| idx % self.of != self.number - 1);
        own.chain(others().skip(self.number - 1)).chain(others().take(self.number - 1))
    }
}

/// Makes shards of the stage's plan in the run folder `root` until none is left to start.
///
/// # Errors
/// When there is no plan yet ([`Blame::Later`]), or the plan belongs to another configuration, program or kind of
/// device; errors of the work.
pub fn work(
    stage: &dyn Stage,
    root: &Path,
    worker: Worker,
    compute: ComputeChoice,
    progress: &dyn Progress,
) -> Result<()> {
    let Work::Sharded(sharded) = stage.work() else { return Ok(()) };
    let no_plan = || {
        Failure::later(format_args!("{} holds no plan to work on yet", root.display()))
            .with_hint("run the part plan first; this command can be repeated until then")
    };
    let done = StageRecord::done(root, stage.kind())?;
    if done.is_none() && ShardFolder::all(root, stage.kind())?.is_empty() {
        return Err(no_plan());
    }
    let record = expected(root, stage)?;
    let is_done = done.is_some_and(|done| done.fingerprint == record.fingerprint || record.is_same_work(&done));
    let Some(folder) = ShardFolder::of(root, stage.kind(), &Identity::own(stage.kind(), record, compute)?)? else {
        return if is_done { Ok(()) } else { Err(no_plan()) };
    };
    let logged = Logged::open(&folder.log(worker.number), progress)?;
    logged.line(&format!("djinn {} begins as worker {worker}", env!("CARGO_PKG_VERSION")));
    let shards = Shards::new(&folder, worker, &logged);
    let outcome = check_inputs(stage).and_then(|()| sharded.make(&shards, &open(stage, compute)?));
    match &outcome {
        Ok(()) => logged.line("no shard is left to start"),
        Err(failure) => logged.line(&format!("ended: {:#}", failure.error)),
    }
    // Sealing or discarding a plan removes the folder while its last workers may still run.
    outcome.map_err(|failure| if folder.is_there() { failure } else { no_plan() })
}

/// The shards of a plan, as one worker sees them.
pub struct Shards<'a> {
    folder: &'a ShardFolder,
    worker: Worker,
    /// Receives the progress.
    pub progress: &'a dyn Progress,
    /// The times of shards that are known to be finished, seconds.
    seconds: RefCell<BTreeMap<usize, f64>>,
}

impl<'a> Shards<'a> {
    /// The shards in `folder`; none has been looked up yet.
    pub(crate) fn new(folder: &'a ShardFolder, worker: Worker, progress: &'a dyn Progress) -> Self {
        Self { folder, worker, progress, seconds: RefCell::default() }
    }

    /// The decisions made before any shard.
    pub fn decisions<P: DeserializeOwned>(&self) -> Result<P> {
        self.folder.decisions()
    }

    /// Whether other workers make shards, too.
    pub fn has_others(&self) -> bool {
        self.worker.of > 1
    }

    /// The folder that workers write into.
    pub fn dir(&self) -> &Path {
        self.folder.dir()
    }

    /// The path for the file of shard `idx`.
    pub fn file(&self, idx: usize) -> PathBuf {
        self.dir().join(self.folder.file_name(idx))
    }

    /// The facts about shard `idx`, if it is finished.
    pub fn finished<S: DeserializeOwned>(&self, idx: usize) -> Option<S> {
        let shard = self.folder.finished::<S>(idx)?;
        self.seconds.borrow_mut().insert(idx, shard.seconds);
        Some(shard.facts)
    }

    fn is_finished(&self, idx: usize) -> bool {
        self.seconds.borrow().contains_key(&idx) || self.finished::<IgnoredAny>(idx).is_some()
    }

    /// Tries each of these shards once, in the worker's order. Afterwards each is finished, not needed or given up.
    /// `make` makes a shard, advances the progress by its `worth`, and returns the stamp of its file with the facts
    /// that the stage needs later.
    ///
    /// # Errors
    /// When the process must stop; errors of making a shard, which its mark then records.
    pub fn go_about<S: Serialize>(
        &self,
        range: Range<usize>,
        worth: &dyn Fn(usize) -> u64,
        is_wanted: &dyn Fn(usize) -> bool,
        make: &mut dyn FnMut(usize) -> Result<(FileStamp, S)>,
    ) -> Result<()> {
        for idx in self.worker.order(range.len()).map(|at| range.start + at) {
            // Stopping here leaves time to remove the mark of a try.
            if self.progress.must_stop() {
                return Err(Failure::later("stopped between shards"));
            }
            if self.is_finished(idx) || !is_wanted(idx) {
                self.progress.advance(worth(idx));
                continue;
            }
            self.try_once(idx, make)?;
        }
        Ok(())
    }

    /// Works on these shards until each is finished, or returns `false` once one is given up. Shards that other workers
    /// have begun are left to them for a while.
    pub fn complete<S: Serialize>(
        &self,
        range: Range<usize>,
        worth: &dyn Fn(usize) -> u64,
        make: &mut dyn FnMut(usize) -> Result<(FileStamp, S)>,
    ) -> Result<bool> {
        self.go_about(range.clone(), worth, &|idx| self.folder.tries(idx).age.is_none(), make)?;
        let mut began = Instant::now();
        loop {
            let left: Vec<usize> = range.clone().filter(|idx| !self.is_finished(*idx)).collect();
            if left.is_empty() {
                return Ok(true);
            }
            if left.iter().any(|idx| self.folder.tries(*idx).are_hopeless()) {
                return Ok(false);
            }
            if self.progress.must_stop() {
                return Err(Failure::later("stopped while other workers finished the round"));
            }
            std::thread::sleep(POLL);
            if began.elapsed() > self.patience() {
                self.go_about(range.clone(), &|_| 0, &|_| true, make)?;
                began = Instant::now();
            }
        }
    }

    /// How long other workers may take for a shard: three times the longest time so far.
    fn patience(&self) -> Duration {
        let longest = self.seconds.borrow().values().copied().fold(0.0, f64::max);
        let patience = if longest > 0.0 { Duration::from_secs_f64(3.0 * longest) } else { UNKNOWN };
        patience.max(LEAST_PATIENCE)
    }

    fn try_once<S: Serialize>(&self, idx: usize, make: &mut dyn FnMut(usize) -> Result<(FileStamp, S)>) -> Result<()> {
        let name = self.worker.to_string();
        let Some(mark) = tries::begin(self.folder.try_paths(idx), &name)? else {
            let why = self.folder.tries(idx).describe();
            self.progress.warn(&format!("giving up shard {idx}: {why}"));
            return Ok(());
        };
        let began = Instant::now();
        let made = catch_unwind(AssertUnwindSafe(|| make(idx)));
        let outcome = match made {
            Ok(outcome) => outcome,
            Err(panic) => {
                // The mark records the panic, which then continues as usual.
                drop(tries::fail(&mark, &name, &panic_message(panic.as_ref())));
                resume_unwind(panic)
            }
        };
        let seconds = began.elapsed().as_secs_f64();
        match outcome.and_then(|made| self.folder.finish(idx, (&name, seconds), made)) {
            Ok(()) => Ok(remove_if_present(&mark)?),
            Err(failure) => {
                match failure.blame {
                    Blame::Later => drop(remove_if_present(&mark)),
                    _ => drop(tries::fail(&mark, &name, &format!("{:#}", failure.error))),
                }
                Err(failure)
            }
        }
    }
}

fn panic_message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("a bug: {}", text.unwrap_or("no message"))
}
