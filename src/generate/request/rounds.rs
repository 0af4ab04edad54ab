//! Decides what to try next: rounds of shards, each planned from the results of finished rounds alone.

use super::config::PlanKind;
use super::draws::{beta, gamma};
use super::ledger::Ledger;
use super::pool::Pool;
use super::resolve::{Arm, ResolvedRequest};
use crate::generate::ShardPlan;
use crate::seed::Seed;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How much untried cells are expected to differ: their rates relative to the mean have a gamma distribution of this
/// shape.
const CELL_SHAPE: f64 = 0.5;
/// The prior of the hit rate of an arm before it is tried: half a hit and one miss.
const PRIOR_HITS: f64 = 0.5;
const PRIOR_MISSES: f64 = 1.0;
/// The number of samples that the prior of an arm that aims is worth.
const AIMED_PRIOR_SAMPLES: f64 = 2.0;
/// The mean rate of an arm, by which cells are compared, starts from [`PRIOR_HITS`] in this many samples.
const PRIOR_SAMPLES: f64 = 1.0;
/// The ease of a cell that reaches a bucket only at the limits of driving; effortless cells have this plus 1.
const LEAST_EASE: f64 = 0.1;

/// Shards that are decided together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// Name of the request.
    pub request: String,
    /// Its number within the request, from 0.
    pub round: usize,
    /// The shards, in order.
    pub shards: Vec<RoundShard>,
}

/// A shard of a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoundShard {
    /// Index of its arm within the request.
    pub arm: usize,
    /// The places of its cells in the pool.
    pub members: Vec<usize>,
    /// The samples to draw.
    pub plan: ShardPlan,
}

/// The basis for the decision on the next round, beside the request.
#[derive(Debug, Clone, Copy)]
pub struct RoundContext<'a> {
    /// The cells.
    pub pool: &'a Pool,
    /// The results of all earlier rounds.
    pub ledger: &'a Ledger,
    /// Number of the round.
    pub round: usize,
    /// Index of the next shard.
    pub next_idx: usize,
    /// Cells of a shard, at most.
    pub cells_per_shard: usize,
    /// The run's seed.
    pub seed: Seed,
}

/// What earlier shards of a round take.
struct Taken {
    /// By cell: the number after that of its last sample.
    next_sample: BTreeMap<usize, usize>,
    /// By bucket: the samples that aim at it.
    aimed: Vec<u64>,
}

impl RoundContext<'_> {
    /// The open buckets that a cell can reach and that have room for it, with the ease of each, from 0.1 to 1.1.
    fn open_buckets(&self, cell: usize) -> impl Iterator<Item = (usize, f64)> {
        let Self { pool, ledger, .. } = *self;
        let reachable = pool.feasible[cell].iter().map(|(bucket, effort)| (*bucket, LEAST_EASE + 1.0 - effort));
        reachable.filter(move |(bucket, _)| ledger.is_open_to(cell, *bucket))
    }
}

impl ResolvedRequest {
    /// The next round. `None` when every bucket that can be filled is full, or the budget is spent.
    pub fn next_round(&self, context: &RoundContext<'_>) -> Option<Round> {
        let RoundContext { ledger, round, .. } = *context;
        if ledger.is_closed() || context.pool.cells.is_empty() {
            return None;
        }
        let mut spent = ledger.spent();
        let mut shards: Vec<RoundShard> = Vec::new();
        let mut taken = Taken { next_sample: BTreeMap::new(), aimed: vec![0; self.buckets.len()] };
        for slot in 0..self.n_slots(round) {
            let arm_idx = self.choose_arm(context, slot);
            let arm = &self.arms[arm_idx];
            let n_samples = arm.n_samples as u64;
            let affordable = self.config.budget.samples_left(spent, arm.n_evaluations) / n_samples;
            let n_cells = context.cells_per_shard.min(affordable as usize).min(context.pool.cells.len());
            if n_cells == 0 {
                break;
            }
            let idx = context.next_idx + shards.len();
            let aims = self.choose_cells(context, slot, (idx, arm, n_cells), &mut taken);
            if aims.is_empty() {
                break;
            }
            let members: Vec<usize> = aims.iter().map(|(cell, _)| *cell).collect();
            let n_planned = n_samples * members.len() as u64;
            spent = (spent.0 + n_planned, spent.1 + n_planned * arm.n_evaluations);
            let plan = self.shard(context, (idx, arm), &aims, &taken);
            let next_sample = plan.first_sample + arm.n_samples;
            for cell in &members {
                let next = taken.next_sample.entry(*cell).or_default();
                *next = next_sample.max(*next);
            }
            shards.push(RoundShard { arm: arm_idx, plan, members });
        }
        (!shards.is_empty()).then(|| Round { request: self.config.name.clone(), round, shards })
    }

    /// The number of shards of a round; the first tries every arm once, all on the same cells.
    fn n_slots(&self, round: usize) -> usize {
        if round == 0 { self.arms.len() } else { self.config.shards_per_round }
    }

    fn choose_arm(&self, context: &RoundContext<'_>, slot: usize) -> usize {
        let RoundContext { ledger, round, .. } = *context;
        if round == 0 {
            return slot;
        }
        if self.config.plan == PlanKind::Even {
            return self.even_shard(round, slot) % self.arms.len();
        }
        let seed = self.slot_seed(context, slot);
        let draw = |arm: usize| {
            let (hits, misses) = self.open_hit_rate(ledger, arm);
            let rate = beta(&mut seed.derive("arm", &[arm as u64]).rng(), hits, misses);
            rate / self.config.budget.cost(self.arms[arm].n_evaluations)
        };
        let draws: Vec<f64> = (0..self.arms.len()).map(draw).collect();
        // The first among equal ones.
        (0..draws.len()).rev().max_by(|a, b| draws[*a].total_cmp(&draws[*b])).unwrap_or(0)
    }

    /// The posterior of how often a sample of an arm falls into an open bucket: Beta of these hits and misses,
    /// pseudo-counts included. An arm that aims has a prior of its own: it is expected to hit buckets at which it has
    /// not aimed as often as the others.
    fn open_hit_rate(&self, ledger: &Ledger, arm: usize) -> (f64, f64) {
        if self.arms[arm].aims {
            let all = ledger.aimed_of_arm(arm, |_| true);
            let open = ledger.aimed_of_arm(arm, |bucket| ledger.is_open(bucket));
            // Laplace's rule of succession.
            let usual = (1.0 + all.n_hits as f64) / (2.0 + all.n_samples as f64);
            let n_missed = (open.n_samples - open.n_hits) as f64;
            (AIMED_PRIOR_SAMPLES * usual + open.n_hits as f64, AIMED_PRIOR_SAMPLES * (1.0 - usual) + n_missed)
        } else {
            let (n, n_open) = (ledger.arms[arm].n_samples as f64, ledger.open_hits_of_arm(arm) as f64);
            (PRIOR_HITS + n_open, PRIOR_MISSES + (n - n_open).max(0.0))
        }
    }

    /// The cells of a shard, each with the bucket that it aims at, if the arm aims.
    fn choose_cells(
        &self,
        context: &RoundContext<'_>,
        slot: usize,
        (idx, arm, n_cells): (usize, &Arm, usize),
        taken: &mut Taken,
    ) -> Vec<(usize, Option<usize>)> {
        let RoundContext { pool, ledger, round, .. } = *context;
        let n = pool.cells.len();
        let aim = |cell: usize, taken: &mut Taken| {
            let bucket = self.aim(context, (idx, cell), &taken.aimed).filter(|_| arm.aims)?;
            taken.aimed[bucket] += arm.n_samples as u64;
            Some(bucket)
        };
        if round == 0 {
            return (0..n_cells).map(|cell| (cell, aim(cell, taken))).collect();
        }
        if self.config.plan == PlanKind::Even {
            let first = self.even_shard(round, slot) / self.arms.len() * context.cells_per_shard;
            return (0..n_cells).map(|i| (first + i) % n).map(|cell| (cell, aim(cell, taken))).collect();
        }
        // The hits of a cell are modeled as Poisson: the rates of the arms that were tried on it, times its
        // suitability. The suitability is drawn from its posterior.
        let n_arms = self.arms.len();
        let rates: Vec<f64> = (0..n_arms).map(|arm| mean_rate(ledger, arm)).collect();
        let seed = self.slot_seed(context, slot);
        let draw = |cell: usize| {
            let n_samples = &ledger.cells[cell].n_samples;
            let n_expected: f64 = rates.iter().zip(n_samples).map(|(rate, n)| rate * *n as f64).sum();
            let mut rng = seed.derive("cell", &[cell as u64]).rng();
            gamma(&mut rng, CELL_SHAPE + ledger.open_hits_of_cell(cell) as f64) / (CELL_SHAPE + n_expected)
        };
        // Cells of another shard of the round come last, and cells that reach no open bucket not at all.
        let ease = |cell: usize| context.open_buckets(cell).map(|(_, ease)| ease).reduce(f64::max);
        let useful = (0..n).filter_map(|cell| Some((cell, ease(cell)?)));
        let mut order: Vec<(bool, f64, usize)> =
            useful.map(|(cell, ease)| (taken.next_sample.contains_key(&cell), draw(cell) * ease, cell)).collect();
        order.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
        let chosen = order.into_iter().map(|(_, _, cell)| (cell, aim(cell, taken)));
        let mut chosen: Vec<_> = chosen.filter(|(_, aim)| aim.is_some() || !arm.aims).take(n_cells).collect();
        chosen.sort_unstable();
        chosen
    }

    /// The index of this shard of an even plan, over all rounds.
    fn even_shard(&self, round: usize, slot: usize) -> usize {
        if round == 0 { slot } else { self.arms.len() + (round - 1) * self.config.shards_per_round + slot }
    }

    /// A shard of new samples. In the first round all arms share their noise, so that they can be compared; afterwards
    /// no noise is used twice in a scene.
    fn shard(
        &self,
        context: &RoundContext<'_>,
        (idx, arm): (usize, &Arm),
        aims: &[(usize, Option<usize>)],
        taken: &Taken,
    ) -> ShardPlan {
        let next = |(cell, _): &(usize, _)| {
            let in_round = taken.next_sample.get(cell).copied().unwrap_or_default();
            context.ledger.cells[*cell].next_sample.max(in_round)
        };
        let first_sample = if context.round == 0 { 0 } else { aims.iter().map(next).max().unwrap_or(0) };
        let cells = aims.iter().map(|(cell, bucket)| {
            let mut own = context.pool.cells[*cell].clone();
            if let Some(bucket) = bucket {
                own.targets = vec![self.buckets.target(*bucket)];
            }
            own
        });
        ShardPlan { idx, sweep_idx: arm.sweep_idx, cells: cells.collect(), first_sample }
    }

    /// The bucket at which the samples of a cell aim: an open one that the cell reaches easily, and that lacks many
    /// scenarios beyond those that `aimed` samples of the round will probably bring. `None` if those will fill it.
    fn aim(&self, context: &RoundContext<'_>, (shard, cell): (usize, usize), aimed: &[u64]) -> Option<usize> {
        let RoundContext { ledger, .. } = *context;
        let lack = |bucket: usize| ledger.lack_after(aimed[bucket], bucket);
        let draw = |bucket: usize| {
            let seed = context.seed.derive_named("request", &self.config.name);
            seed.derive("aim", &[shard as u64, cell as u64, bucket as u64]).rng().uniform()
        };
        let open = context.open_buckets(cell).filter(|(bucket, _)| lack(*bucket) > 0.0);
        let open = open.map(|(bucket, ease)| (ease * (lack(bucket) + draw(bucket)), bucket));
        open.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, bucket)| bucket)
    }

    fn slot_seed(&self, context: &RoundContext<'_>, slot: usize) -> Seed {
        let indices = [context.round as u64, slot as u64];
        context.seed.derive_named("request", &self.config.name).derive("slot", &indices)
    }
}

/// How often samples of an arm fall into open buckets.
fn mean_rate(ledger: &Ledger, arm: usize) -> f64 {
    (PRIOR_HITS + ledger.open_hits_of_arm(arm) as f64) / (PRIOR_SAMPLES + ledger.arms[arm].n_samples as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::request::tests::{pool, tight};
    use crate::generate::request::{CellTally, Hits, ShardTally};

    #[test]
    fn rates_are_those_of_open_buckets() {
        let request = tight("arms = ['plain', 'aimed']\nper_bucket = 2\nbudget = { n_samples = 300 }");
        let mut ledger = Ledger::new(&request, &pool(3));
        // Bucket 0 lacks one, and bucket 1 is full.
        for (arm, bucket, n_samples, n_accepted, n_surplus) in [(0, 0, 9, 0, 3), (1, 0, 10, 1, 2), (1, 1, 20, 2, 0)] {
            let hits = BTreeMap::from([(bucket, Hits { n_accepted, n_surplus, ..Hits::default() })]);
            let cell = CellTally { n_samples, aimed: (arm == 1).then_some(bucket), hits, ..CellTally::default() };
            ledger.add(&ShardTally { request: "tight".to_owned(), round: 0, arm, cells: vec![cell] });
        }
        assert_eq!([0, 1].map(|arm| mean_rate(&ledger, arm)), [3.5 / 10.0, 3.5 / 31.0]);
        assert_eq!(request.open_hit_rate(&ledger, 0), (3.5, 7.0));
        // Of all 30 samples that aimed, 5 hit: by Laplace's rule, 6 in 32.
        assert_eq!(request.open_hit_rate(&ledger, 1), (2.0 * 0.1875 + 3.0, 2.0 * 0.8125 + 7.0));
    }
}
