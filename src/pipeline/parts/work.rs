//! The second part: any number of processes sample shards.

use super::folder::PartsFolder;
use super::identity::Identity;
use super::{STAGE, tries};
use crate::files::remove_if_present;
use crate::generate::{Plan, ResolvedGeneration, ShardPlan};
use crate::pipeline::graph::{check_inputs, expected};
use crate::pipeline::log::Logged;
use crate::pipeline::stages::{Generate, SampleSidecar};
use crate::pipeline::{Blame, ComputeChoice, Failure, Result, StageRecord};
use crate::progress::Progress;
use std::collections::BTreeMap;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::str::FromStr;
use std::time::Instant;

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
        let worker = read().filter(|worker| (1..=worker.of).contains(&worker.number) && worker.of <= 100_000);
        worker.ok_or_else(|| "expected K/N with K from 1 to N, such as 3/100".to_owned())
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

/// Samples shards of the plan in the run folder `root` until none is left to be begun.
///
/// # Errors
/// When there is no plan yet ([`Blame::Later`]), or the plan is of another configuration, program or kind of device; those of sampling.
pub fn work(
    root: &Path,
    generate: &Generate<'_>,
    worker: Worker,
    compute: ComputeChoice,
    progress: &dyn Progress,
) -> Result<()> {
    let no_plan = || {
        Failure::later(format_args!("{} holds no plan to work on yet", root.display()))
            .with_hint("run the part plan first; this command can be repeated until then")
    };
    let done = StageRecord::done(root, STAGE);
    if done.is_none() && PartsFolder::all(root)?.is_empty() {
        return Err(no_plan());
    }
    let stage = expected(root, generate)?;
    let is_done = done.is_some_and(|done| done.fingerprint == stage.fingerprint || stage.is_same_work(&done));
    let Some(folder) = PartsFolder::of(root, &Identity::own(stage, compute)?)? else {
        return if is_done { Ok(()) } else { Err(no_plan()) };
    };
    let logged = Logged::open(&folder.log(worker.number), progress)?;
    logged.line(&format!("djinn {} begins as worker {worker}", env!("CARGO_PKG_VERSION")));
    let outcome = (|| {
        check_inputs(generate)?;
        let plan = folder.plan()?;
        let samples = folder.samples()?;
        generate.with_ready(&compute.open()?, |ready| {
            logged.start("work", plan.n_samples(ready.resolved) as u64, "samples");
            let sample = |shard: &ShardPlan| ready.sample(shard, &samples, &logged);
            Shards { folder: &folder, plan: &plan, resolved: ready.resolved, n_verified: BTreeMap::new() }
                .work_through(worker, &sample, &logged)?;
            logged.finish();
            Ok(())
        })
    })();
    match &outcome {
        Ok(()) => logged.line("nothing is left to be begun"),
        Err(failure) => logged.line(&format!("ended: {:#}", failure.error)),
    }
    // Who seals or discards a plan takes the folder from its last workers.
    outcome.map_err(|failure| if folder.is_there() { failure } else { no_plan() })
}

/// The shards of a plan, as one worker sees them.
pub(super) struct Shards<'a> {
    pub(super) folder: &'a PartsFolder,
    pub(super) plan: &'a Plan,
    pub(super) resolved: &'a ResolvedGeneration,
    /// Verified scenarios of those that are known to be finished, by index.
    pub(super) n_verified: BTreeMap<usize, u64>,
}

impl Shards<'_> {
    /// Goes about the shards in the worker's order, once. Each is then finished, unwanted or given up.
    pub(super) fn work_through(
        mut self,
        worker: Worker,
        sample: &dyn Fn(&ShardPlan) -> Result<SampleSidecar>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let plan = self.plan;
        for idx in worker.order(plan.shards.len()) {
            let shard = &plan.shards[idx];
            // Whoever has asked is given the time to take back the mark of a try.
            if progress.must_stop() {
                return Err(Failure::later("stopped between shards"));
            }
            if self.is_finished(idx) || !self.may_be_wanted(shard) {
                progress.advance(shard.n_samples(self.resolved) as u64);
                continue;
            }
            self.try_once(shard, worker, sample, progress)?;
        }
        Ok(())
    }

    pub(super) fn is_finished(&mut self, idx: usize) -> bool {
        if !self.n_verified.contains_key(&idx)
            && let Some(finished) = self.folder.finished(idx)
        {
            self.n_verified.insert(idx, finished.shard.n_verified);
        }
        self.n_verified.contains_key(&idx)
    }

    /// Whether one process might generate the shard: not if those before it that are finished have enough verified scenarios already.
    fn may_be_wanted(&mut self, shard: &ShardPlan) -> bool {
        if shard.is_wanted(self.resolved, usize::MAX) {
            return true;
        }
        let plan = self.plan;
        let before = plan.shards[..shard.idx].iter().filter(|other| other.sweep_idx == shard.sweep_idx);
        before.for_each(|other| _ = self.is_finished(other.idx));
        let before = plan.shards[..shard.idx].iter().filter(|other| other.sweep_idx == shard.sweep_idx);
        let n_verified: u64 = before.filter_map(|other| self.n_verified.get(&other.idx)).sum();
        shard.is_wanted(self.resolved, n_verified as usize)
    }

    fn try_once(
        &self,
        shard: &ShardPlan,
        worker: Worker,
        sample: &dyn Fn(&ShardPlan) -> Result<SampleSidecar>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let name = worker.to_string();
        let Some(mark) = tries::begin(self.folder, shard.idx, &name)? else {
            let why = tries::Tries::of(self.folder, shard.idx).describe();
            progress.warn(&format!("shard {} is given up: {why}", shard.idx));
            return Ok(());
        };
        let began = Instant::now();
        let finished = catch_unwind(AssertUnwindSafe(|| sample(shard)));
        let outcome = match finished {
            Ok(outcome) => outcome,
            Err(panic) => {
                // The shard learns of it; everything else about a panic is as everywhere.
                drop(tries::fail(&mark, &name, &panic_message(panic.as_ref())));
                resume_unwind(panic)
            }
        };
        match outcome.and_then(|sidecar| self.folder.finish(shard.idx, &name, began.elapsed().as_secs_f64(), sidecar)) {
            Ok(_) => Ok(remove_if_present(&mark)?),
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
