//! Requests: rounds of shards until every bucket is full or the budget is spent.
//!
//! The shards of a round depend only on the decision for that round, so workers sample them in any order. A worker that
//! finds a round complete reads its shards in order and decides the next one; all workers would decide the same.
//!
//! Whether a scenario is accepted depends on the scenarios before it. Workers therefore only record the bucket of each
//! scenario; the process that finishes decides, and writes the tables again with its decisions.

use super::ready::Ready;
use super::sample_folder::{DecidedShard, SampleSidecar, read_round, write_round};
use super::sharded::{GenerationPlan, SampledShard};
use crate::engine::shards::{Gathering, Shards};
use crate::engine::{Failure, Result};
use crate::generate::{
    KnownTemplates, Ledger, Pool, RequestSummary, ResolvedGeneration, ResolvedRequest, Round, RoundContext, RoundShard,
    ShardTally,
};
use crate::progress::{Progress, Silent};
use crate::scenario::RequestTag;
use crate::seed::Seed;
use std::path::Path;

/// Samples the shards of requests, round by round, until all requests are fulfilled or a shard is given up.
pub(super) fn make(plan: &GenerationPlan, ready: &Ready<'_>, shards: &Shards<'_>) -> Result<()> {
    let rounds = Rounds { resolved: ready.resolved, ready: Some(ready), dir: shards.dir(), progress: shards.progress };
    let mut next_idx = plan.sweeps.shards.len();
    for (request, pool) in ready.resolved.requests.iter().zip(&plan.pools) {
        shards.progress.start(&format!("request {}", request.config.name), 0, "samples");
        let walked = rounds.go_through((request, pool), &mut next_idx, &mut Sampling { ready, shards })?;
        shards.progress.finish();
        if walked.is_none() {
            break;
        }
    }
    Ok(())
}

/// Provides the shards of rounds, or makes them.
trait RoundShards {
    /// Announces a round before its shards are requested one by one.
    fn begin(&mut self, of: (&ResolvedRequest, &Pool), round: &Round) -> Result<()>;

    /// Notes that the round from this shard on must be decided first.
    fn note_undecided(&mut self, next_idx: usize) -> Result<()>;

    /// The tally of a shard of the round with this number, when `ledger` holds all earlier ones; `None` if it is
    /// missing.
    fn tally(
        &mut self,
        of: (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>>;
}

/// The rounds of requests.
struct Rounds<'a> {
    resolved: &'a ResolvedGeneration,
    /// Decides rounds without a file; `None`: the next round is the first without one.
    ready: Option<&'a Ready<'a>>,
    /// The folder of the decided rounds.
    dir: &'a Path,
    progress: &'a dyn Progress,
}

impl Rounds<'_> {
    /// Goes through the rounds of a request, whose shards are numbered from `next_idx`. Returns the ledger and the
    /// number of rounds; `None` if a shard is missing.
    fn go_through(
        &self,
        (request, pool): (&ResolvedRequest, &Pool),
        next_idx: &mut usize,
        shards: &mut dyn RoundShards,
    ) -> Result<Option<(Ledger, usize)>> {
        let mut ledger = Ledger::new(request, pool);
        let mut n_rounds = 0;
        let known = KnownTemplates::default();
        loop {
            let Some(round) = self.round(request, (pool, &ledger), (n_rounds, *next_idx), &known)? else {
                shards.note_undecided(*next_idx)?;
                return Ok(None);
            };
            if round.shards.is_empty() {
                break;
            }
            shards.begin((request, pool), &round)?;
            for shard in &round.shards {
                // Whether the rest of a round is needed depends on its earlier shards, which are the same in every
                // attempt.
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
        if !ledger.is_closed() && !request.has_spent(ledger.spent()) {
            ledger.exhaust();
        }
        Ok(Some((ledger, n_rounds)))
    }

    /// The round as it was decided, without shards if the request has ended; decides it if it was not. `None` where
    /// that cannot be done.
    fn round(
        &self,
        request: &ResolvedRequest,
        (pool, ledger): (&Pool, &Ledger),
        (round, next_idx): (usize, usize),
        known: &KnownTemplates,
    ) -> Result<Option<Round>> {
        if let Some(decided) = read_round(self.dir, request.idx, round)? {
            return Ok(Some(decided));
        }
        let Some(Ready { generator, .. }) = self.ready else { return Ok(None) };
        let config = self.resolved;
        let templates = |arm: usize, cell: usize, bucket: usize| {
            if !config.sweeps[request.arms[arm].sweep_idx].uses_template() {
                return Ok(None);
            }
            let find = || generator.shown(request, arm, &pool.cells[cell], bucket);
            known.get((arm, cell, bucket), find).map(Some)
        };
        let decided = request.next_round(&RoundContext {
            pool,
            ledger,
            round,
            next_idx,
            cells_per_shard: config.scenes_per_shard,
            seed: Seed(config.seed),
            templates: Some(&templates),
        })?;
        let end = || Round { request: request.config.name.clone(), round, shards: Vec::new() };
        let decided = decided.unwrap_or_else(end);
        write_round(self.dir, request.idx, &decided)?;
        Ok(Some(decided))
    }
}

/// Samples the rounds of a request as a worker.
struct Sampling<'a> {
    ready: &'a Ready<'a>,
    shards: &'a Shards<'a>,
}

impl RoundShards for Sampling<'_> {
    /// Several workers sample a round side by side; a single one samples only what is still needed after earlier
    /// shards.
    fn begin(&mut self, of: (&ResolvedRequest, &Pool), round: &Round) -> Result<()> {
        if self.shards.has_others() { self.complete(of, &round.shards).map(drop) } else { Ok(()) }
    }

    fn note_undecided(&mut self, _: usize) -> Result<()> {
        Ok(())
    }

    fn tally(
        &mut self,
        of: (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>> {
        self.complete(of, std::slice::from_ref(shard))?;
        let finished = self.shards.finished(shard.plan.idx);
        finished.map(|sampled| Ok(decided(of.0, (round, shard), ledger, &sampled)?.0)).transpose()
    }
}

impl Sampling<'_> {
    /// Samples those of consecutive shards that are not finished.
    fn complete(&self, of: (&ResolvedRequest, &Pool), of_round: &[RoundShard]) -> Result<bool> {
        let first = of_round.first().map_or(0, |shard| shard.plan.idx);
        let shard = |idx: usize| &of_round[idx - first];
        let worth = |idx: usize| shard(idx).plan.n_samples(self.ready.resolved) as u64;
        self.shards.complete(first..first + of_round.len(), &worth, &mut |idx| {
            let sampled = self.sample(of, shard(idx))?;
            Ok((sampled.sidecar.stamp.clone(), sampled))
        })
    }

    fn sample(&self, (request, pool): (&ResolvedRequest, &Pool), shard: &RoundShard) -> Result<SampledShard> {
        let Self { ready, shards } = self;
        let output = ready.generate(&shard.plan, shards.progress)?;
        let placed = ready.generator.place(request, (pool, shard), &output.records)?;
        Ok(SampledShard { sidecar: ready.write(&shard.plan, shards.dir(), output)?, placed })
    }
}

/// Decides the rounds of all requests, as far as their shards exist. Returns the shards that count, and the results of
/// each request.
pub(super) fn gather(
    plan: &GenerationPlan,
    resolved: &ResolvedGeneration,
    shards: &mut Gathering<'_>,
) -> Result<(Vec<DecidedShard>, Vec<RequestSummary>)> {
    let dir = shards.dir().to_owned();
    let rounds = Rounds { resolved, ready: None, dir: &dir, progress: &Silent };
    let mut next_idx = plan.sweeps.shards.len();
    let mut deciding = Deciding { shards, done: Vec::new() };
    let mut summaries = Vec::new();
    for (request, pool) in resolved.requests.iter().zip(&plan.pools) {
        let walked = rounds.go_through((request, pool), &mut next_idx, &mut deciding)?;
        let Some((ledger, n_rounds)) = walked else { break };
        summaries.push(RequestSummary::new(request, pool, &ledger, n_rounds));
    }
    Ok((deciding.done, summaries))
}

/// Decides the rounds of a request in the process that finishes.
struct Deciding<'a, 'g> {
    shards: &'a mut Gathering<'g>,
    done: Vec<DecidedShard>,
}

impl RoundShards for Deciding<'_, '_> {
    fn begin(&mut self, _: (&ResolvedRequest, &Pool), round: &Round) -> Result<()> {
        self.shards.expect_more(round.shards.len());
        Ok(())
    }

    fn note_undecided(&mut self, next_idx: usize) -> Result<()> {
        self.shards.expect_more(1);
        self.shards.look_up::<SampledShard>(next_idx).map(drop)
    }

    fn tally(
        &mut self,
        (request, _): (&ResolvedRequest, &Pool),
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
    ) -> Result<Option<ShardTally>> {
        let idx = shard.plan.idx;
        let Some(sampled) = self.shards.look_up(idx)? else { return Ok(None) };
        let (tally, tags) = decided(request, (round, shard), ledger, &sampled)?;
        let sidecar = SampleSidecar { request: Some(tally.clone()), ..sampled.sidecar };
        self.done.push(DecidedShard { idx, sidecar, tags });
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
    let SampledShard { sidecar, placed } = sampled;
    if sidecar.n_scenarios != placed.len() as u64 || !request.may_decide(shard, placed) {
        let message = format!("the record of {} is damaged or belongs to another shard", sidecar.file);
        let hint = "plan again with --stage generate --part plan --redo generate";
        return Err(Failure::fault(anyhow::anyhow!(message)).with_hint(hint));
    }
    Ok(request.decide(round, shard, ledger, placed))
}

/// Warns of buckets that stay short.
pub(super) fn warn_of_short(summary: &RequestSummary, progress: &dyn Progress) {
    let n_short = summary.short().count();
    if n_short == 0 {
        return;
    }
    let counted = |n: usize, what: &str| if n == 0 { String::new() } else { format!("; {what} {n} of them") };
    let given_up = counted(summary.given_up().count(), "pairs brought nothing more for");
    let infeasible = counted(summary.infeasible().count(), "no pair can reach");
    progress.warn(&format!(
        "request {}: {n_short} of {} buckets stayed short ({} of {} scenarios){infeasible}{given_up}; the report says \
         which. Raise its budget, add arms that reach them, or add scenes",
        summary.name,
        summary.buckets.len(),
        summary.n_accepted,
        summary.n_wanted
    ));
}
