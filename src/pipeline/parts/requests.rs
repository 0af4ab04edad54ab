//! Requests by several processes. The shards of a round depend only on the decision for that round, so workers sample
//! them in any order. A worker that finds a round complete reads its shards in order and decides the next one; all
//! workers would decide the same.
//!
//! Whether a scenario is accepted depends on the scenarios before it. Workers therefore only record the bucket of each
//! scenario; the process that seals decides, and writes the tables again with its decisions.

use super::folder::PartsFolder;
use super::gathering::Gathering;
use super::generation::{GenerationPlan, SampledShard};
use super::work::Shards;
use crate::files::{files_below, link_or_copy};
use crate::generate::{Ledger, Pool, ResolvedGeneration, ResolvedRequest, Round, RoundShard, ShardOutput, ShardTally};
use crate::pipeline::stages::{Ready, RoundShards, Rounds, SampleFolder, SampleSidecar, is_round_file};
use crate::pipeline::{Failure, Result};
use crate::progress::Silent;
use crate::scenario::RequestTag;
use crate::store::{SceneStore, read_samples};
use rayon::prelude::*;
use std::path::Path;

/// Samples the shards of requests, round by round, until all requests are fulfilled or a shard is given up.
pub(super) fn work(
    plan: &GenerationPlan,
    ready: &Ready<'_>,
    samples: &SampleFolder,
    shards: &Shards<'_, SampledShard>,
) -> Result<()> {
    let rounds = Rounds { resolved: ready.resolved, folder: samples, progress: shards.progress };
    let mut next_idx = plan.sweeps.shards.len();
    for (request, pool) in ready.resolved.requests.iter().zip(&plan.pools) {
        shards.progress.start(&format!("request {}", request.config.name), 0, "samples");
        let walked = rounds.go_through((request, pool), &mut next_idx, &mut Sampling { ready, samples, shards })?;
        shards.progress.finish();
        if walked.is_none() {
            break;
        }
    }
    Ok(())
}

/// Samples the rounds of a request as a worker.
struct Sampling<'a> {
    ready: &'a Ready<'a>,
    samples: &'a SampleFolder,
    shards: &'a Shards<'a, SampledShard>,
}

impl RoundShards for Sampling<'_> {
    fn begin(&mut self, of: (&ResolvedRequest, &Pool), round: &Round) -> Result<()> {
        let first = round.shards.first().map_or(0, |shard| shard.plan.idx);
        let shard = |idx: usize| &round.shards[idx - first];
        let worth = |idx: usize| shard(idx).plan.n_samples(self.ready.resolved) as u64;
        let range = first..first + round.shards.len();
        self.shards.complete(range, &worth, &mut |idx| self.sample(of, shard(idx))).map(drop)
    }

    fn tally(
        &mut self,
        (request, _): (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>> {
        let finished = self.shards.finished(shard.plan.idx);
        finished.map(|sampled| Ok(decided(request, (round, shard), ledger, &sampled)?.0)).transpose()
    }
}

impl Sampling<'_> {
    fn sample(&self, (request, pool): (&ResolvedRequest, &Pool), shard: &RoundShard) -> Result<SampledShard> {
        let Ready { generator, resolved, .. } = self.ready;
        let output = generator.generate(&shard.plan, self.shards.progress)?;
        let placed = generator.place(request, (pool, shard), &output.records)?;
        let sweep = &resolved.sweeps[shard.plan.sweep_idx];
        let described = (sweep.name.as_str(), sweep.n_evaluations());
        let sidecar = self.samples.write_table(shard.plan.idx, described, output, None)?;
        Ok(SampledShard { sidecar, placed, tags: Vec::new() })
    }
}

/// Gathers the shards of requests, with their tallies.
pub(super) fn gather(
    plan: &GenerationPlan,
    resolved: &ResolvedGeneration,
    shards: &mut Gathering<'_, SampledShard>,
) -> Result<()> {
    let folder = SampleFolder::open_for_writing(shards.dir())?;
    let rounds = Rounds { resolved, folder: &folder, progress: &Silent };
    let mut next_idx = plan.sweeps.shards.len();
    for (request, pool) in resolved.requests.iter().zip(&plan.pools) {
        if rounds.go_through((request, pool), &mut next_idx, &mut Deciding(shards))?.is_none() {
            break;
        }
    }
    Ok(())
}

/// Decides the rounds of a request in the process that seals.
struct Deciding<'a, 'g>(&'a mut Gathering<'g, SampledShard>);

impl RoundShards for Deciding<'_, '_> {
    fn begin(&mut self, _: (&ResolvedRequest, &Pool), round: &Round) -> Result<()> {
        self.0.expect_more(round.shards.len());
        Ok(())
    }

    fn tally(
        &mut self,
        (request, _): (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>> {
        let Some(sampled) = self.0.look_up(shard.plan.idx)? else { return Ok(None) };
        let (tally, tags) = decided(request, (round, shard), ledger, &sampled)?;
        let sidecar = SampleSidecar { request: Some(tally.clone()), ..sampled.sidecar };
        self.0.take(shard.plan.idx, SampledShard { sidecar, placed: sampled.placed, tags });
        Ok(Some(tally))
    }
}

/// The tally of a shard, and the tags of its scenarios.
fn decided(
    request: &ResolvedRequest,
    (round, shard): (usize, &RoundShard),
    ledger: &Ledger,
    sampled: &SampledShard,
) -> Result<(ShardTally, Vec<RequestTag>)> {
    let SampledShard { sidecar, placed, .. } = sampled;
    if sidecar.n_scenarios != placed.len() as u64 || !request.may_decide(shard, placed) {
        let message = format!("the record of {} is damaged or belongs to another shard", sidecar.file);
        let hint = "plan again with --stage generate --part plan --redo generate";
        return Err(Failure::fault(anyhow::anyhow!(message)).with_hint(hint));
    }
    Ok(request.decide(round, shard, ledger, placed))
}

/// Writes the pools, the rounds and the decided shards of requests into the folder `samples`.
pub(super) fn publish(
    plan: &GenerationPlan,
    shards: &[(usize, SampledShard)],
    parts: &PartsFolder,
    (samples, scenes): (&SampleFolder, &Path),
) -> Result<()> {
    if plan.pools.is_empty() {
        return Ok(());
    }
    plan.pools.iter().enumerate().try_for_each(|(request, pool)| samples.write_pool(request, pool))?;
    for name in files_below(parts.dir())?.iter().filter(|name| name.to_str().is_some_and(is_round_file)) {
        let place = samples.path(&name.to_string_lossy());
        if !place.exists() {
            link_or_copy(&parts.dir().join(name), &place)?;
        }
    }
    let store = SceneStore::open(scenes)?;
    shards.par_iter().filter(|(_, shard)| shard.sidecar.request.is_some()).try_for_each(|(idx, shard)| {
        let SampledShard { sidecar, tags, .. } = shard;
        if samples.finished(*idx)?.is_some_and(|finished| finished.request == sidecar.request) {
            return Ok(());
        }
        let mut records = read_samples(&parts.dir().join(&sidecar.file), &store)?;
        records.iter_mut().zip(tags).for_each(|(record, tag)| record.request = Some(tag.clone()));
        let (rejected, unselected) = (sidecar.rejected.clone(), sidecar.unselected.clone());
        let output = ShardOutput { records, rejected, unselected };
        let described = (sidecar.sweep.as_str(), sidecar.n_evaluations);
        samples.write_shard(*idx, described, output, sidecar.request.clone()).map(drop)
    })
}
