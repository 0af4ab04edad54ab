//! Generation in parts: workers sample shards of the sweeps. Requests, which decide as they go, are fulfilled by the process that seals.

use super::folder::PartsFolder;
use super::gathering::Gathering;
use super::work::Shards;
use super::{PartFile, PartedStage};
use crate::files::{FileStamp, link_or_copy};
use crate::generate::{Plan, ResolvedGeneration, ShardPlan};
use crate::pipeline::layout::SAMPLES;
use crate::pipeline::stages::{Generate, SampleFolder, SampleSidecar};
use crate::pipeline::{ComputeChoice, Result};
use crate::progress::Progress;
use std::path::Path;

impl PartFile for SampleSidecar {
    fn file(&self) -> (&str, &FileStamp) {
        (&self.file, &self.stamp)
    }
}

impl PartedStage for Generate<'_> {
    type Plan = Plan;
    type Shard = SampleSidecar;

    fn plan(&self, compute: ComputeChoice, progress: &dyn Progress) -> Result<Plan> {
        self.with_ready(&compute.open()?, |ready| ready.plan(progress))
    }

    fn n_shards(plan: &Plan) -> usize {
        plan.shards.len()
    }

    fn work(&self, plan: &Plan, shards: &Shards<'_, SampleSidecar>, compute: ComputeChoice) -> Result<()> {
        let samples = SampleFolder::open_for_writing(shards.dir())?;
        self.with_ready(&compute.open()?, |ready| {
            shards.progress.start("work", plan.n_samples(ready.resolved) as u64, "samples");
            work_through(shards, plan, ready.resolved, &mut |shard| ready.sample(shard, &samples, shards.progress))?;
            shards.progress.finish();
            Ok(())
        })
    }

    fn gather(&self, plan: &Plan, shards: &mut Gathering<'_, SampleSidecar>) -> Result<()> {
        gather(plan, &self.resolve()?, shards)
    }

    fn publish(&self, plan: &Plan, shards: &[(usize, SampleSidecar)], parts: &PartsFolder, work: &Path) -> Result<()> {
        let samples = SampleFolder::open_for_writing(&work.join(SAMPLES))?;
        samples.write_plan(plan)?;
        for (idx, shard) in shards {
            if samples.finished(*idx).as_ref() != Some(shard) {
                link_or_copy(&parts.dir().join(&shard.file), &samples.path(&shard.file))?;
                samples.write_sidecar(*idx, shard)?;
            }
        }
        Ok(())
    }
}

/// Samples the shards of the plan that may be wanted.
pub(super) fn work_through(
    shards: &Shards<'_, SampleSidecar>,
    plan: &Plan,
    resolved: &ResolvedGeneration,
    sample: &mut dyn FnMut(&ShardPlan) -> Result<SampleSidecar>,
) -> Result<()> {
    let n_samples = |idx: usize| plan.shards[idx].n_samples(resolved) as u64;
    let may_be_wanted = |idx: usize| may_be_wanted(shards, plan, resolved, idx);
    shards.go_about(plan.shards.len(), &n_samples, &may_be_wanted, &mut |idx| sample(&plan.shards[idx]))
}

/// Whether one process might generate the shard: not if those before it that are finished have enough verified scenarios already.
fn may_be_wanted(
    shards: &Shards<'_, SampleSidecar>,
    plan: &Plan,
    resolved: &ResolvedGeneration,
    idx: usize,
) -> bool {
    let shard = &plan.shards[idx];
    if shard.is_wanted(resolved, usize::MAX) {
        return true;
    }
    let before = plan.shards[..idx].iter().filter(|other| other.sweep_idx == shard.sweep_idx);
    let n_verified = before.filter_map(|other| shards.finished(other.idx)).map(|other| other.n_verified).sum::<u64>();
    shard.is_wanted(resolved, n_verified as usize)
}

/// Gathers the shards that one process would have sampled. Of a sweep that stops early, what comes after a missing shard may not be
/// wanted: it waits.
pub(super) fn gather(
    plan: &Plan,
    resolved: &ResolvedGeneration,
    shards: &mut Gathering<'_, SampleSidecar>,
) -> Result<()> {
    let mut n_verified = vec![0; resolved.n_sweeps];
    let mut waits = vec![false; resolved.n_sweeps];
    for shard in &plan.shards {
        let sweep = shard.sweep_idx;
        if !shard.is_wanted(resolved, n_verified[sweep]) {
            continue;
        }
        match shards.look_up(shard.idx)? {
            Some(finished) => {
                n_verified[sweep] += finished.n_verified as usize;
                if !waits[sweep] {
                    shards.take(shard.idx, finished);
                }
            }
            None => waits[sweep] = !shard.is_wanted(resolved, usize::MAX),
        }
    }
    Ok(())
}
