//! Requests: rounds of shards until every bucket is full or the budget is spent. Finished shards survive an
//! interruption.
//!
//! One process samples the shards of a round one after the other. Workers sample them in any order and read them
//! afterwards ([`RoundShards`]).

use super::sample_folder::{SampleFolder, SampleSidecar};
use crate::generate::{
    Generator, Ledger, Pool, RequestSummary, ResolvedGeneration, ResolvedRequest, Round, RoundContext, RoundShard,
    ShardTally,
};
use crate::pipeline::{Failure, Result, StageContext};
use crate::progress::Progress;
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
    /// Fulfills all requests, one after the other, with shards from `next_idx` on. Warns of buckets that stay short.
    pub(super) fn all(&self, mut next_idx: usize) -> Result<(Vec<SampleSidecar>, Vec<RequestSummary>)> {
        let (mut shards, mut summaries) = (Vec::new(), Vec::new());
        for request in &self.resolved.requests {
            let (done, summary) = self.one(request, &mut next_idx)?;
            let n_short = summary.short().count();
            if n_short > 0 {
                let n_infeasible = summary.infeasible().count();
                let told = |n: usize, what: &str| if n == 0 { String::new() } else { format!("; {what} {n} of them") };
                let given_up = told(summary.given_up().count(), "nothing came of 200 samples in a row that aimed at");
                let infeasible = told(n_infeasible, "no pair can reach");
                self.context.progress.warn(&format!(
                    "request {}: {n_short} of {} buckets stayed short ({} of {} scenarios){infeasible}{given_up}; the report says which. Raise its \
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
        let mut alone = Alone { fulfilment: self, done: Vec::new() };
        let rounds = Rounds { resolved: self.resolved, folder: self.folder, progress };
        let walked = rounds.go_through((request, &pool), next_idx, &mut alone)?;
        progress.finish();
        let Some((ledger, n_rounds)) = walked else {
            return Err(Failure::fault(anyhow::anyhow!(
                "a shard of request {} is missing and was not sampled",
                request.config.name
            )));
        };
        Ok((alone.done, RequestSummary::new(request, &pool, &ledger, n_rounds)))
    }

    fn pool(&self, request: &ResolvedRequest) -> Result<Pool> {
        if let Some(pool) = self.folder.pool(request.idx)? {
            return Ok(pool);
        }
        let pool = self.generator.pool(request, self.store.index())?;
        self.folder.write_pool(request.idx, &pool)?;
        Ok(pool)
    }
}

/// Provides the shards of rounds, or makes them.
pub(in crate::pipeline) trait RoundShards {
    /// Announces a round before its shards are requested one by one.
    fn begin(&mut self, of: (&ResolvedRequest, &Pool), round: &Round) -> Result<()>;

    /// The tally of a shard of the round of this number, when `ledger` holds all earlier ones; `None` if it is missing.
    fn tally(
        &mut self,
        of: (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>>;
}

/// The rounds of requests; rounds without a file are decided.
pub(in crate::pipeline) struct Rounds<'a> {
    /// What is sampled.
    pub(in crate::pipeline) resolved: &'a ResolvedGeneration,
    /// Where what was decided is kept.
    pub(in crate::pipeline) folder: &'a SampleFolder,
    /// Receives the progress.
    pub(in crate::pipeline) progress: &'a dyn Progress,
}

impl Rounds<'_> {
    /// Goes through the rounds of a request, whose shards are numbered from `next_idx` on. Returns the ledger and the
    /// number of rounds; `None` if a shard is missing.
    pub(in crate::pipeline) fn go_through(
        &self,
        (request, pool): (&ResolvedRequest, &Pool),
        next_idx: &mut usize,
        shards: &mut dyn RoundShards,
    ) -> Result<Option<(Ledger, usize)>> {
        let mut ledger = Ledger::new(request, pool);
        let mut n_rounds = 0;
        while let Some(round) = self.round(request, (pool, &ledger), n_rounds, *next_idx)? {
            shards.begin((request, pool), &round)?;
            for shard in &round.shards {
                // Whether the rest of a round is wanted depends on its earlier shards, which are the same in every attempt.
                if ledger.is_closed() {
                    break;
                }
                let Some(tally) = shards.tally((request, pool), n_rounds, shard, &ledger)? else { return Ok(None) };
                ledger.add(&tally);
                let n_wanted = request.buckets.wanted().iter().sum::<u64>();
                self.progress.note(&format!("round {n_rounds}, {} of {n_wanted} accepted", ledger.n_accepted()));
            }
            *next_idx += round.shards.len();
            n_rounds += 1;
        }
        Ok(Some((ledger, n_rounds)))
    }

    /// The round as it was decided, or decides it.
    fn round(
        &self,
        request: &ResolvedRequest,
        (pool, ledger): (&Pool, &Ledger),
        round: usize,
        next_idx: usize,
    ) -> Result<Option<Round>> {
        if let Some(decided) = self.folder.round(request.idx, round)? {
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
}

/// One process, which samples shard after shard.
struct Alone<'a> {
    fulfilment: &'a Fulfilment<'a>,
    done: Vec<SampleSidecar>,
}

impl RoundShards for Alone<'_> {
    fn begin(&mut self, _: (&ResolvedRequest, &Pool), _: &Round) -> Result<()> {
        Ok(())
    }

    /// The tally of the finished shard, or generates the shard.
    fn tally(
        &mut self,
        (request, pool): (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>> {
        let Fulfilment { generator, resolved, folder, context, .. } = *self.fulfilment;
        let sidecar = match folder.finished(shard.plan.idx)?.filter(|sidecar| sidecar.request.is_some()) {
            Some(sidecar) => {
                context.progress.advance(shard.plan.n_samples(resolved) as u64);
                sidecar
            }
            None => {
                let mut output = generator.generate(&shard.plan, context.progress)?;
                let tally = generator.judge((request, round), (pool, shard), ledger, &mut output.records)?;
                let sweep = &resolved.sweeps[shard.plan.sweep_idx];
                let described = (sweep.name.as_str(), sweep.n_evaluations());
                folder.write_shard(shard.plan.idx, described, output, Some(tally))?
            }
        };
        let tally = sidecar.request.clone();
        self.done.push(sidecar);
        Ok(tally)
    }
}
