//! Decides what to try next: rounds of shards, each planned from the results of finished rounds alone.

use super::config::PlanKind;
use super::draws::{beta, gamma};
use super::ledger::Ledger;
use super::pool::Pool;
use super::resolve::{Arm, ResolvedRequest};
use super::shown::{Shown, Templates};
use crate::generate::{Cell, Error, ShardPlan};
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
    /// What each of them aims at, if it does.
    pub aims: Vec<Option<CellAim>>,
    /// The samples to draw.
    pub plan: ShardPlan,
}

/// What the samples of a cell aim at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct CellAim {
    /// The bucket that they are expected to fall into.
    pub bucket: usize,
    /// The bucket for which their templates, or objectives, are solved.
    pub solved_for: usize,
}

/// A cell of a shard: its place in the pool, its aim, and the templates that its samples follow if they are chosen.
pub(super) type Member = (usize, Option<CellAim>, Option<Vec<usize>>);

/// The basis for the decision on the next round, beside the request.
#[derive(Clone, Copy)]
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
    /// The templates of cells. `None`: samples follow those of their cell in turn.
    pub templates: Option<&'a Templates<'a>>,
}

/// What earlier shards of a round take.
pub(super) struct Taken {
    /// By cell: the number after that of its last sample.
    next_sample: BTreeMap<usize, usize>,
    /// By bucket: the samples that aim at it.
    pub(super) aimed: Vec<u64>,
    /// The templates that they follow: each with its arm, its cell, its aim and what it shows.
    pub(super) templates: Vec<(usize, usize, CellAim, Shown)>,
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
    /// The next round. `None` when every bucket that can be filled is full, the budget is spent, or no cell has
    /// anything more.
    ///
    /// # Errors
    /// When templates cannot be looked at.
    pub fn next_round(&self, context: &RoundContext<'_>) -> Result<Option<Round>, Error> {
        let RoundContext { ledger, round, .. } = *context;
        if ledger.is_closed() || context.pool.cells.is_empty() {
            return Ok(None);
        }
        let mut spent = ledger.spent();
        let mut shards: Vec<RoundShard> = Vec::new();
        let aimed = vec![0; self.buckets.len()];
        let mut taken = Taken { next_sample: BTreeMap::new(), aimed, templates: Vec::new() };
        // Arms without a cell for any open bucket.
        let mut barren = vec![false; self.arms.len()];
        let mut slot = 0;
        while slot < self.n_slots(round) {
            let Some(arm_idx) = self.choose_arm(context, slot, &barren) else { break };
            let arm = &self.arms[arm_idx];
            let affordable = self.config.budget.samples_left(spent, arm.n_evaluations) / arm.n_samples as u64;
            let n_cells = context.cells_per_shard.min(affordable as usize).min(context.pool.cells.len());
            if n_cells == 0 {
                break;
            }
            let idx = context.next_idx + shards.len();
            let members = self.choose_cells(context, slot, (idx, arm_idx, n_cells), &mut taken)?;
            if members.is_empty() {
                // The first round and the grid go on with the next arm; otherwise the slot falls to another one.
                barren[arm_idx] = true;
                slot += usize::from(round == 0 || self.config.plan == PlanKind::Even);
                continue;
            }
            slot += 1;
            let shard = self.shard(context, (idx, arm_idx), members, &taken);
            let n_of = |at: usize| shard.plan.n_samples_of(at, arm.n_samples);
            let n_planned = (0..shard.members.len()).map(n_of).sum::<usize>() as u64;
            spent = (spent.0 + n_planned, spent.1 + n_planned * arm.n_evaluations);
            for (at, cell) in shard.members.iter().enumerate() {
                let next = taken.next_sample.entry(*cell).or_default();
                *next = (*next).max(shard.plan.first_sample + n_of(at));
            }
            shards.push(shard);
        }
        Ok((!shards.is_empty()).then(|| Round { request: self.config.name.clone(), round, shards }))
    }

    /// Whether the budget allows no shard of any arm after what is spent.
    pub fn has_spent(&self, spent: (u64, u64)) -> bool {
        let is_left = |arm: &Arm| self.config.budget.samples_left(spent, arm.n_evaluations) >= arm.n_samples as u64;
        !self.arms.iter().any(is_left)
    }

    /// The number of shards of a round; the first tries every arm once, all on the same cells.
    fn n_slots(&self, round: usize) -> usize {
        if round == 0 { self.arms.len() } else { self.config.shards_per_round }
    }

    /// The arm of a shard; `None` if all of those that learn from results are `barren`.
    fn choose_arm(&self, context: &RoundContext<'_>, slot: usize, barren: &[bool]) -> Option<usize> {
        let RoundContext { ledger, round, .. } = *context;
        if round == 0 {
            return Some(slot);
        }
        if self.config.plan == PlanKind::Even {
            return Some(self.even_shard(round, slot) % self.arms.len());
        }
        let seed = self.slot_seed(context, slot);
        let draw = |arm: usize| {
            let (hits, misses) = self.open_hit_rate(ledger, arm);
            let rate = beta(&mut seed.derive("arm", &[arm as u64]).rng(), hits, misses);
            rate / self.config.budget.cost(self.arms[arm].n_evaluations)
        };
        let draws: Vec<f64> = (0..self.arms.len()).map(draw).collect();
        // The first among equal ones.
        (0..draws.len()).rev().filter(|arm| !barren[*arm]).max_by(|a, b| draws[*a].total_cmp(&draws[*b]))
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

    /// The cells of a shard, each with its aim, if the arm aims.
    fn choose_cells(
        &self,
        context: &RoundContext<'_>,
        slot: usize,
        (idx, arm, n_cells): (usize, usize, usize),
        taken: &mut Taken,
    ) -> Result<Vec<Member>, Error> {
        let RoundContext { pool, round, .. } = *context;
        let n = pool.cells.len();
        if self.config.plan == PlanKind::Even && round > 0 {
            let first = self.even_shard(round, slot) / self.arms.len() * context.cells_per_shard;
            return self.members(context, (idx, arm), (0..n_cells).map(|i| (first + i) % n), taken).collect();
        }
        if round == 0 {
            return self.members(context, (idx, arm), 0..n_cells, taken).collect();
        }
        let order = self.cells_in_order(context, slot, taken);
        let is_aimed = |member: &Member| member.1.is_some() || !self.arms[arm].aims;
        let members = self.members(context, (idx, arm), order.into_iter(), taken);
        let mut chosen: Vec<Member> =
            members.filter(|member| member.as_ref().map_or(true, is_aimed)).take(n_cells).collect::<Result<_, _>>()?;
        chosen.sort_unstable();
        Ok(chosen)
    }

    /// Cells that reach an open bucket, in the order in which they are tried in this slot.
    fn cells_in_order(&self, context: &RoundContext<'_>, slot: usize, taken: &Taken) -> Vec<usize> {
        let RoundContext { pool, ledger, .. } = *context;
        let n = pool.cells.len();
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
        order.into_iter().map(|(_, _, cell)| cell).collect()
    }

    /// The index of this shard of an even plan, over all rounds.
    fn even_shard(&self, round: usize, slot: usize) -> usize {
        if round == 0 { slot } else { self.arms.len() + (round - 1) * self.config.shards_per_round + slot }
    }

    /// These cells with their aims and, where they are known, with templates, without those that have none.
    fn members<'a>(
        &'a self,
        context: &'a RoundContext<'a>,
        (idx, arm): (usize, usize),
        cells: impl Iterator<Item = usize> + 'a,
        taken: &'a mut Taken,
    ) -> impl Iterator<Item = Result<Member, Error>> + 'a {
        let Arm { aims, n_samples, .. } = self.arms[arm];
        let templates = context.templates.filter(|_| aims && self.config.plan == PlanKind::Adaptive);
        cells.filter_map(move |cell| {
            let in_order = if aims { self.aims(context, (idx, cell), &taken.aimed) } else { Vec::new() };
            if let Some(templates) = templates {
                match self.with_templates(context, (arm, cell), (&in_order, templates), taken) {
                    Ok(Some(member)) => return member.map(Ok),
                    Ok(None) => {}
                    Err(error) => return Some(Err(error)),
                }
            }
            let aim = in_order.first().map(|bucket| CellAim { bucket: *bucket, solved_for: *bucket });
            if let Some(aim) = aim {
                taken.aimed[aim.bucket] += n_samples as u64;
            }
            Some(Ok((cell, aim, None)))
        })
    }

    /// A shard of new samples. In the first round all arms share their noise, so that they can be compared; afterwards
    /// no noise is used twice in a scene.
    fn shard(
        &self,
        context: &RoundContext<'_>,
        (idx, arm): (usize, usize),
        chosen: Vec<Member>,
        taken: &Taken,
    ) -> RoundShard {
        let next = |(cell, ..): &Member| {
            let in_round = taken.next_sample.get(cell).copied().unwrap_or_default();
            context.ledger.cells[*cell].next_sample.max(in_round)
        };
        let first_sample = if context.round == 0 { 0 } else { chosen.iter().map(next).max().unwrap_or(0) };
        let (mut members, mut aims, mut cells, mut templates) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (cell, aim, own) in chosen {
            let targets = aim.map(|aim| self.buckets.target(aim.solved_for)).into_iter().collect();
            cells.push(Cell { targets, ..context.pool.cells[cell].clone() });
            members.push(cell);
            aims.push(aim);
            templates.extend(own);
        }
        let plan = ShardPlan { idx, sweep_idx: self.arms[arm].sweep_idx, cells, first_sample, templates };
        RoundShard { arm, members, aims, plan }
    }

    /// The buckets at which the samples of a cell may aim, the best one first: open ones that the cell reaches easily,
    /// and that lack many scenarios beyond those that `aimed` samples of the round will probably bring. None that those
    /// will fill.
    fn aims(&self, context: &RoundContext<'_>, (shard, cell): (usize, usize), aimed: &[u64]) -> Vec<usize> {
        let RoundContext { ledger, .. } = *context;
        let lack = |bucket: usize| ledger.lack_after(aimed[bucket], bucket);
        let draw = |bucket: usize| {
            let seed = context.seed.derive_named("request", &self.config.name);
            seed.derive("aim", &[shard as u64, cell as u64, bucket as u64]).rng().uniform()
        };
        let open = context.open_buckets(cell).filter(|(bucket, _)| lack(*bucket) > 0.0);
        let mut open: Vec<(f64, usize)> =
            open.map(|(bucket, ease)| (ease * (lack(bucket) + draw(bucket)), bucket)).collect();
        open.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
        open.into_iter().map(|(_, bucket)| bucket).collect()
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
