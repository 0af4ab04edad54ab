//! The second part: any number of processes make shards.

use super::Identity;
use super::folder::{PartShard, PartsFolder};
use super::tries::{self, Tries};
use super::{PartFile, PartedStage};
use crate::files::remove_if_present;
use crate::pipeline::graph::{check_inputs, expected};
use crate::pipeline::log::Logged;
use crate::pipeline::{Blame, ComputeChoice, Failure, Result, StageRecord};
use crate::progress::Progress;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// How long workers wait for shards of others at the least, and while none is known.
const LEAST_PATIENCE: Duration = Duration::from_secs(2);
const UNKNOWN: Duration = Duration::from_secs(10);
/// How often they look.
const POLL: Duration = Duration::from_millis(200);

/// Which of the workers this is. Several may bear one number: it only says where they begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Worker {
    /// Its number, from 1.
    number: usize,
    /// How many there are.
    of: usize,
}

impl FromStr for Worker {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (number, of) = text.split_once('/')?;
            Some(Self { number: number.parse().ok()?, of: of.parse().ok()? })
        };
        let worker = read().filter(|worker| worker.number <= worker.of && (1..=100_000).contains(&worker.of));
        // Engines that count from 0 have no last one.
        let counted = worker.map(|Self { number, of }| Self { number: if number == 0 { of } else { number }, of });
        counted.ok_or_else(|| "expected K/N with K from 1 to N, or from 0 to N - 1, such as 3/100".to_owned())
    }
}

impl fmt::Display for Worker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Worker {
    /// The shards in the order in which this worker goes about them: its own ones first, then those of others from the end backward,
    /// where those are that nobody has come to yet. Every worker begins at another one, so that they do not all take the same.
    pub(super) fn order(self, n_shards: usize) -> impl Iterator<Item = usize> {
        let own = (self.number - 1..n_shards).step_by(self.of);
        let others = move || (0..n_shards).rev().filter(move |idx| idx % self.of != self.number - 1);
        own.chain(others().skip(self.number - 1)).chain(others().take(self.number - 1))
    }
}

/// See [`InParts::work`](super::InParts::work).
pub(super) fn work<S: PartedStage>(
    stage: &S,
    root: &Path,
    worker: Worker,
    compute: ComputeChoice,
    progress: &dyn Progress,
) -> Result<()> {
    let no_plan = || {
        Failure::later(format_args!("{} holds no plan to work on yet", root.display()))
            .with_hint("run the part plan first; this command can be repeated until then")
    };
    let done = StageRecord::done(root, stage.id());
    if done.is_none() && PartsFolder::all(root, stage.id())?.is_empty() {
        return Err(no_plan());
    }
    let record = expected(root, stage)?;
    let is_done = done.is_some_and(|done| done.fingerprint == record.fingerprint || record.is_same_work(&done));
    let Some(folder) = PartsFolder::of(root, &Identity::own(record, compute)?)? else {
        return if is_done { Ok(()) } else { Err(no_plan()) };
    };
    let logged = Logged::open(&folder.log(worker.number), progress)?;
    logged.line(&format!("djinn {} begins as worker {worker}", env!("CARGO_PKG_VERSION")));
    let shards = Shards::new(&folder, worker, &logged);
    let outcome = check_inputs(stage).and_then(|()| stage.work(&folder.plan()?, &shards, compute));
    match &outcome {
        Ok(()) => logged.line("nothing is left to be begun"),
        Err(failure) => logged.line(&format!("ended: {:#}", failure.error)),
    }
    // Who seals or discards a plan takes the folder from its last workers.
    outcome.map_err(|failure| if folder.is_there() { failure } else { no_plan() })
}

/// The shards of a plan, as one worker sees them.
pub(super) struct Shards<'a, S> {
    folder: &'a PartsFolder,
    worker: Worker,
    /// Receives the progress.
    pub(super) progress: &'a dyn Progress,
    /// Those that are known to be finished.
    finished: RefCell<BTreeMap<usize, PartShard<S>>>,
}

impl<'a, S: PartFile> Shards<'a, S> {
    /// Those in `folder`, of which nothing is known yet.
    pub(super) fn new(folder: &'a PartsFolder, worker: Worker, progress: &'a dyn Progress) -> Self {
        Self { folder, worker, progress, finished: RefCell::default() }
    }

    /// The folder that workers write into.
    pub(super) fn dir(&self) -> &Path {
        self.folder.dir()
    }

    /// The name of the file of shard `idx`.
    pub(super) fn file_name(&self, idx: usize) -> String {
        self.folder.file_name(idx)
    }

    /// What is known of shard `idx`, if it is finished.
    pub(super) fn finished(&self, idx: usize) -> Option<S> {
        Some(match self.finished.borrow_mut().entry(idx) {
            Entry::Occupied(known) => known.get().shard.clone(),
            Entry::Vacant(place) => place.insert(self.folder.finished::<S>(idx)?).shard.clone(),
        })
    }

    /// Goes about these shards in the worker's order, once. Each is then finished, unwanted or given up. `make` makes one,
    /// advances the progress by what it is `worth`, and says what is known of it.
    ///
    /// # Errors
    /// When the process is to stop; those of making a shard, whose mark says why.
    pub(super) fn go_about(
        &self,
        range: Range<usize>,
        worth: &dyn Fn(usize) -> u64,
        is_wanted: &dyn Fn(usize) -> bool,
        make: &mut dyn FnMut(usize) -> Result<S>,
    ) -> Result<()> {
        for idx in self.worker.order(range.len()).map(|at| range.start + at) {
            // Whoever has asked is given the time to take back the mark of a try.
            if self.progress.must_stop() {
                return Err(Failure::later("stopped between shards"));
            }
            if self.finished(idx).is_some() || !is_wanted(idx) {
                self.progress.advance(worth(idx));
                continue;
            }
            self.try_once(idx, make)?;
        }
        Ok(())
    }

    /// Goes about these shards until each is finished; or given up, which returns `false`. What other workers are at is left to them for
    /// a while.
    ///
    /// # Errors
    /// As [`Shards::go_about`].
    pub(super) fn complete(
        &self,
        range: Range<usize>,
        worth: &dyn Fn(usize) -> u64,
        make: &mut dyn FnMut(usize) -> Result<S>,
    ) -> Result<bool> {
        self.go_about(range.clone(), worth, &|idx| Tries::of(self.folder, idx).age.is_none(), make)?;
        let mut began = Instant::now();
        loop {
            let left: Vec<usize> = range.clone().filter(|idx| self.finished(*idx).is_none()).collect();
            if left.is_empty() {
                return Ok(true);
            }
            if left.iter().any(|idx| Tries::of(self.folder, *idx).are_hopeless()) {
                return Ok(false);
            }
            if self.progress.must_stop() {
                return Err(Failure::later("stopped while other workers were at the rest of a round"));
            }
            std::thread::sleep(POLL);
            if began.elapsed() > self.patience() {
                self.go_about(range.clone(), &|_| 0, &|_| true, make)?;
                began = Instant::now();
            }
        }
    }

    /// How long others may take for a shard: three times what any has taken so far.
    fn patience(&self) -> Duration {
        let longest = self.finished.borrow().values().map(|finished| finished.seconds).fold(0.0, f64::max);
        let patience = if longest > 0.0 { Duration::from_secs_f64(3.0 * longest) } else { UNKNOWN };
        patience.max(LEAST_PATIENCE)
    }

    fn try_once(&self, idx: usize, make: &mut dyn FnMut(usize) -> Result<S>) -> Result<()> {
        let name = self.worker.to_string();
        let Some(mark) = tries::begin(self.folder, idx, &name)? else {
            let why = Tries::of(self.folder, idx).describe();
            self.progress.warn(&format!("shard {idx} is given up: {why}"));
            return Ok(());
        };
        let began = Instant::now();
        let made = catch_unwind(AssertUnwindSafe(|| make(idx)));
        let outcome = match made {
            Ok(outcome) => outcome,
            Err(panic) => {
                // The shard learns of it; everything else about a panic is as everywhere.
                drop(tries::fail(&mark, &name, &panic_message(panic.as_ref())));
                resume_unwind(panic)
            }
        };
        match outcome.and_then(|shard| self.folder.finish(idx, &name, began.elapsed().as_secs_f64(), &shard)) {
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
