//! Requests: rounds of shards until every bucket is full or the budget is spent; what is finished is kept when interrupted.

use super::sample_folder::{SampleFolder, SampleSidecar};
use crate::generate::{
    Generator, Ledger, Pool, RequestSummary, ResolvedGeneration, ResolvedRequest, Round, RoundContext, RoundShard,
};
use crate::pipeline::{Result, StageContext};
use crate::seed::Seed;
use crate::store::SceneStore;

/// What requests are fulfilled with.
pub(super) struct Fulfilment<'a> {
    pub(super) generator: &'a Generator<'a>,
    pub(super) resolved: &'a ResolvedGeneration,
    pub(super) store: &'a SceneStore,
    pub(super) folder: &'a SampleFolder,
    pub(super) context: &'a StageContext<'a>,
}

impl Fulfilment<'_> {
    /// Fulfils all requests, one after the other, with shards from `next_idx` on. Buckets that stay short are told.
    pub(super) fn all(&self, mut next_idx: usize) -> Result<(Vec<SampleSidecar>, Vec<RequestSummary>)> {
        let (mut shards, mut summaries) = (Vec::new(), Vec::new());
        for request in &self.resolved.requests {
            let (done, summary) = self.one(request, &mut next_idx)?;
            let n_short = summary.short().count();
            if n_short > 0 {
                let n_infeasible = summary.infeasible().count();
                let infeasible = match n_infeasible {
                    0 => String::new(),
                    n => format!("; no pair can reach {n} of them"),
                };
                self.context.progress.warn(&format!(
                    "request {}: {n_short} of {} buckets stayed short ({} of {} scenarios){infeasible}; the report says which. Raise its \
                     budget, add arms that reach them, or add scenes",
                    summary.name,
                    summary.buckets.len(),
                    summary.n_accepted,
                    summary.n_wanted
                ));
            }
            shards.extend(done);
            summaries.push(summary);
        }
        if !summaries.is_empty() {
            self.folder.write_requests(&summaries)?;
        }
        Ok((shards, summaries))
    }

    fn one(&self, request: &ResolvedRequest, next_idx: &mut usize) -> Result<(Vec<SampleSidecar>, RequestSummary)> {
        let progress = self.context.progress;
        progress.start(&format!("request {}", request.config.name), 0, "samples");
        let pool = self.pool(request)?;
        let mut ledger = Ledger::new(request, &pool);
        let mut done = Vec::new();
        let mut n_rounds = 0;
        while let Some(round) = self.round(request, (&pool, &ledger), n_rounds, *next_idx)? {
            for shard in &round.shards {
                // Whether the rest of a round is wanted depends on its earlier shards, which are the same in every attempt.
                if ledger.is_full() {
                    break;
                }
                done.push(self.shard(request, n_rounds, (&pool, shard), &mut ledger)?);
                progress.note(&format!(
                    "round {n_rounds}, {} of {} accepted",
                    ledger.n_accepted(),
                    request.buckets.wanted().iter().sum::<u64>()
                ));
            }
            *next_idx += round.shards.len();
            n_rounds += 1;
        }
        progress.finish();
        Ok((done, RequestSummary::new(request, &pool, &ledger, n_rounds)))
    }

    fn pool(&self, request: &ResolvedRequest) -> Result<Pool> {
        if let Some(pool) = self.folder.pool(request.idx) {
            return Ok(pool);
        }
        let pool = self.generator.pool(request, self.store.index())?;
        self.folder.write_pool(request.idx, &pool)?;
        Ok(pool)
    }

    /// The round as it was decided, or decides it.
    fn round(
        &self,
        request: &ResolvedRequest,
        (pool, ledger): (&Pool, &Ledger),
        round: usize,
        next_idx: usize,
    ) -> Result<Option<Round>> {
        if let Some(decided) = self.folder.round(request.idx, round) {
            return Ok(Some(decided));
        }
        let config = self.resolved;
        let decided = request.next_round(&RoundContext {
            pool,
            ledger,
            round,
            next_idx,
            cells_per_shard: config.scenes_per_shard,
            seed: Seed(config.seed),
        });
        if let Some(decided) = &decided {
            self.folder.write_round(request.idx, decided)?;
        }
        Ok(decided)
    }

    /// The shard as it was finished, or generates it; and adds what it came to.
    fn shard(
        &self,
        request: &ResolvedRequest,
        round: usize,
        (pool, shard): (&Pool, &RoundShard),
        ledger: &mut Ledger,
    ) -> Result<SampleSidecar> {
        let resolved = self.resolved;
        let sidecar = match self.folder.finished(shard.plan.idx).filter(|sidecar| sidecar.request.is_some()) {
            Some(sidecar) => {
                self.context.progress.advance(shard.plan.n_samples(resolved) as u64);
                sidecar
            }
            None => {
                let mut output = self.generator.generate(&shard.plan, self.context.progress)?;
                let tally = self.generator.judge((request, round), (pool, shard), ledger, &mut output.records)?;
                let sweep = &resolved.sweeps[shard.plan.sweep_idx];
                let described = (sweep.name.as_str(), sweep.n_evaluations());
                self.folder.write_shard(shard.plan.idx, described, output, Some(tally))?
            }
        };
        sidecar.request.iter().for_each(|tally| ledger.add(tally));
        Ok(sidecar)
    }
}
