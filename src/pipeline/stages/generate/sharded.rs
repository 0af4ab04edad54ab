//! The shards of generation: first those of sweeps, then those of requests ([`rounds`]).

use super::rounds::{self, warn_of_short};
use super::sample_folder::{DecidedShard, SampleFolder, SampleSettings, SampleSidecar, SampledWith};
use super::{Generate, differs_from_default};
use crate::engine::shards::{Division, Gathering, Sharded, Shards};
use crate::engine::{Result, StageContext};
use crate::generate::{PlacedScenario, Plan, Pool, ResolvedGeneration, ShardPlan, Shortfall};
use crate::metrics::MetricSettings;
use crate::nn::Compute;
use crate::pipeline::layout::SAMPLES;
use crate::progress::Progress;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The decisions made before any shard is sampled.
#[derive(Serialize, Deserialize)]
pub(super) struct GenerationPlan {
    pub(super) sweeps: Plan,
    /// The cells of each request.
    pub(super) pools: Vec<Pool>,
    /// The models and settings with which the shards are sampled.
    sampled_with: SampledWith,
    /// The settings by which scenarios are judged.
    metric_settings: MetricSettings,
}

/// Facts about a sampled shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SampledShard {
    /// Its sidecar; for a request, without the tally until the shards are gathered.
    pub(super) sidecar: SampleSidecar,
    /// The buckets of the scenarios of a request.
    pub(super) placed: Vec<PlacedScenario>,
}

impl Sharded for Generate<'_> {
    fn plan(&self, compute: &Compute, progress: &dyn Progress) -> Result<Division> {
        self.with_ready(compute, None, |ready| {
            let sweeps = ready.plan(progress)?;
            let pools = ready.pools()?;
            ready.warn_of_infeasible(&pools, progress);
            let sampled_with = ready.sampled_with(&sweeps, &pools);
            let metric_settings = ready.metric_settings.clone();
            Division::new(sweeps.shards.len(), &GenerationPlan { sweeps, pools, sampled_with, metric_settings })
        })
    }

    fn make(&self, shards: &Shards<'_>, compute: &Compute) -> Result<()> {
        let plan: GenerationPlan = shards.decisions()?;
        self.with_ready(compute, Some(plan.metric_settings.clone()), |ready| {
            let mut sample = |shard: &ShardPlan| ready.sample(shard, shards.dir(), shards.progress);
            make_sweeps(shards, &plan.sweeps, ready.resolved, &mut sample)?;
            rounds::make(&plan, ready, shards)
        })
    }

    fn finish(&self, shards: &mut Gathering<'_>, context: &StageContext<'_>) -> Result<Value> {
        let plan: GenerationPlan = shards.decisions()?;
        let resolved = self.resolve()?;
        let mut done = gather_sweeps(&plan.sweeps, shards)?;
        let (of_requests, summaries) = rounds::gather(&plan, &resolved, shards)?;
        shards.check_whole()?;
        let GenerationPlan { sweeps, pools, sampled_with, metric_settings } = plan;
        for Shortfall { sweep, n_wanted, n_found } in &sweeps.shortfalls {
            context.progress.warn(&format!("sweep {sweep}: {n_wanted} scenes requested, {n_found} suitable"));
        }
        sampled_with.caution().into_iter().for_each(|caution| context.progress.warn(&caution));
        summaries.iter().for_each(|summary| warn_of_short(summary, context.progress));
        let folder = SampleFolder::create(&context.root.join(SAMPLES))?;
        let (mine, generate) = (self.mine.clone(), self.config.clone());
        let metric_settings = Some(metric_settings).filter(differs_from_default);
        folder.write_settings(&SampleSettings { mine, generate, metric_settings })?;
        folder.write_plan(&sweeps)?;
        done.iter().try_for_each(|sidecar| folder.take(shards.dir(), &sidecar.file))?;
        if !summaries.is_empty() {
            folder.write_requests(&summaries)?;
            folder.take_rounds(shards.dir(), &pools)?;
            let store = self.open_scenes()?;
            let write = |shard: DecidedShard| folder.write_decided(shards.dir(), shard, &store);
            done.extend(of_requests.into_par_iter().map(write).collect::<Result<Vec<_>>>()?);
        }
        let manifest = folder.write_manifest(done, sampled_with)?;
        if manifest.n_rejected > 0 {
            let message = format!("{} samples had non-finite values and were rejected", manifest.n_rejected);
            context.progress.warn(&message);
        }
        let mut summary = json!({
            "n_scenarios": manifest.n_scenarios,
            "n_verified": manifest.n_verified,
            "n_rejected": manifest.n_rejected,
        });
        if !summaries.is_empty() {
            summary["n_wanted"] = summaries.iter().map(|request| request.n_wanted).sum::<u64>().into();
            summary["n_accepted"] = summaries.iter().map(|request| request.n_accepted).sum::<u64>().into();
        }
        Ok(summary)
    }
}

/// Samples the shards of the sweeps.
fn make_sweeps(
    shards: &Shards<'_>,
    plan: &Plan,
    resolved: &ResolvedGeneration,
    sample: &mut dyn FnMut(&ShardPlan) -> Result<SampleSidecar>,
) -> Result<()> {
    if plan.shards.is_empty() {
        return Ok(());
    }
    let progress = shards.progress;
    progress.start("generate", plan.n_samples(resolved) as u64, "samples");
    let n_samples = |idx: usize| plan.shards[idx].n_samples(resolved) as u64;
    let mut n_verified = 0;
    shards.go_about(0..plan.shards.len(), &n_samples, &|_| true, &mut |idx| {
        let sidecar = sample(&plan.shards[idx])?;
        n_verified += sidecar.n_verified;
        progress.note(&format!("{n_verified} verified"));
        Ok((sidecar.stamp.clone(), SampledShard { sidecar, placed: Vec::new() }))
    })?;
    progress.finish();
    Ok(())
}

fn gather_sweeps(plan: &Plan, shards: &mut Gathering<'_>) -> Result<Vec<SampleSidecar>> {
    let mut found = Vec::new();
    for shard in &plan.shards {
        if let Some(SampledShard { sidecar, .. }) = shards.look_up(shard.idx)? {
            found.push(sidecar);
        }
    }
    Ok(found)
}
