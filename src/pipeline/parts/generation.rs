//! Generation in parts: workers sample shards of the sweeps, and then those of requests, round by round (`requests`).

use super::folder::PartsFolder;
use super::gathering::Gathering;
use super::work::Shards;
use super::{PartFile, PartedStage, requests};
use crate::files::{FileStamp, link_or_copy};
use crate::generate::{PlacedScenario, Plan, Pool, ResolvedGeneration, ShardPlan};
use crate::pipeline::layout::SAMPLES;
use crate::pipeline::stages::{Generate, SampleFolder, SampleSidecar};
use crate::pipeline::{ComputeChoice, Result};
use crate::progress::Progress;
use crate::scenario::RequestTag;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The decisions made before any shard is sampled.
#[derive(Serialize, Deserialize)]
pub(super) struct GenerationPlan {
    /// The shards of the sweeps.
    pub(super) sweeps: Plan,
    /// The cells of each request.
    pub(super) pools: Vec<Pool>,
}

/// A shard that a worker has sampled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SampledShard {
    /// Published with the shard. For a request, it lacks the tally until the shards are gathered.
    #[serde(flatten)]
    pub(super) sidecar: SampleSidecar,
    /// The buckets of the scenarios of a request.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) placed: Vec<PlacedScenario>,
    /// Their tags, once the shards are gathered.
    #[serde(skip)]
    pub(super) tags: Vec<RequestTag>,
}

impl SampledShard {
    /// A shard of a sweep.
    pub(super) fn of_sweep(sidecar: SampleSidecar) -> Self {
        Self { sidecar, placed: Vec::new(), tags: Vec::new() }
    }
}

impl PartFile for SampledShard {
    fn file(&self) -> (&str, &FileStamp) {
        (&self.sidecar.file, &self.sidecar.stamp)
    }
}

impl PartedStage for Generate<'_> {
    type Plan = GenerationPlan;
    type Shard = SampledShard;

    fn plan(&self, compute: ComputeChoice, progress: &dyn Progress) -> Result<GenerationPlan> {
        self.with_ready(&compute.open()?, |ready| {
            Ok(GenerationPlan { sweeps: ready.plan(progress)?, pools: ready.pools()? })
        })
    }

    fn n_shards(plan: &GenerationPlan) -> usize {
        plan.sweeps.shards.len()
    }

    fn work(&self, plan: &GenerationPlan, shards: &Shards<'_, SampledShard>, compute: ComputeChoice) -> Result<()> {
        let samples = SampleFolder::open_for_writing(shards.dir())?;
        self.with_ready(&compute.open()?, |ready| {
            shards.progress.start("work", plan.sweeps.n_samples(ready.resolved) as u64, "samples");
            let mut sample = |shard: &ShardPlan| ready.sample(shard, &samples, shards.progress);
            work_through(shards, &plan.sweeps, ready.resolved, &mut sample)?;
            shards.progress.finish();
            requests::work(plan, ready, &samples, shards)
        })
    }

    fn gather(&self, plan: &GenerationPlan, shards: &mut Gathering<'_, SampledShard>) -> Result<()> {
        let resolved = self.resolve()?;
        gather(&plan.sweeps, &resolved, shards)?;
        requests::gather(plan, &resolved, shards)
    }

    fn publish(
        &self,
        plan: &GenerationPlan,
        shards: &[(usize, SampledShard)],
        parts: &PartsFolder,
        work: &Path,
    ) -> Result<()> {
        let samples = SampleFolder::open_for_writing(&work.join(SAMPLES))?;
        samples.write_plan(&plan.sweeps)?;
        for (idx, SampledShard { sidecar, .. }) in shards.iter().filter(|(_, shard)| shard.sidecar.request.is_none()) {
            if samples.finished(*idx)?.as_ref() != Some(sidecar) {
                link_or_copy(&parts.dir().join(&sidecar.file), &samples.path(&sidecar.file))?;
                samples.write_sidecar(*idx, sidecar)?;
            }
        }
        requests::publish(plan, shards, parts, (&samples, &self.layout.scenes))
    }
}

/// Samples the shards of the plan that may be needed.
pub(super) fn work_through(
    shards: &Shards<'_, SampledShard>,
    plan: &Plan,
    resolved: &ResolvedGeneration,
    sample: &mut dyn FnMut(&ShardPlan) -> Result<SampleSidecar>,
) -> Result<()> {
    let n_samples = |idx: usize| plan.shards[idx].n_samples(resolved) as u64;
    let may_be_wanted = |idx: usize| may_be_wanted(shards, plan, resolved, idx);
    shards.go_about(0..plan.shards.len(), &n_samples, &may_be_wanted, &mut |idx| {
        Ok(SampledShard::of_sweep(sample(&plan.shards[idx])?))
    })
}

/// Whether one process might generate the shard: not if the finished shards before it already have enough verified
/// scenarios.
fn may_be_wanted(shards: &Shards<'_, SampledShard>, plan: &Plan, resolved: &ResolvedGeneration, idx: usize) -> bool {
    let shard = &plan.shards[idx];
    if shard.is_wanted(resolved, usize::MAX) {
        return true;
    }
    let before = plan.shards[..idx].iter().filter(|other| other.sweep_idx == shard.sweep_idx);
    let n_verified =
        before.filter_map(|other| shards.finished(other.idx)).map(|other| other.sidecar.n_verified).sum::<u64>();
    shard.is_wanted(resolved, n_verified as usize)
}

/// Gathers the shards that one process would have sampled. If a sweep stops early, shards after a missing one wait,
/// because they may not be needed.
pub(super) fn gather(
    plan: &Plan,
    resolved: &ResolvedGeneration,
    shards: &mut Gathering<'_, SampledShard>,
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
                n_verified[sweep] += finished.sidecar.n_verified as usize;
                if !waits[sweep] {
                    shards.take(shard.idx, finished);
                }
            }
            None => waits[sweep] = !shard.is_wanted(resolved, usize::MAX),
        }
    }
    Ok(())
}
