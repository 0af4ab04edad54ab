//! The results of a request so far: counts by bucket, arm and cell, from the tallies of finished shards in order.

use super::config::PlanKind;
use super::event_values::EventValues;
use super::pool::Pool;
use super::resolve::ResolvedRequest;
use crate::metrics::{PairPath, PathIndex};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A bucket is given up after this many samples in a row that aimed at it and were not accepted. At a rate of one in
/// fifty, this happens in 2 of 100 cases.
const N_FRUITLESS: u64 = 200;
/// A cell has nothing more for a bucket after this many near-duplicates in a row.
const N_ALIKE: u64 = 4;
/// It has nothing, either, after so many samples in a row that aimed at it in vain that this many of them are usually
/// hits: e⁻⁴ of the cells with the usual rate are closed wrongly.
const N_USUAL_HITS: f64 = 4.0;

/// The results of a finished shard of a request.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShardTally {
    /// Name of the request.
    pub request: String,
    /// The round it belongs to.
    pub round: usize,
    /// Index of its arm within the request.
    pub arm: usize,
    /// Its cells.
    pub cells: Vec<CellTally>,
}

/// The results of a cell in a shard.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CellTally {
    /// Its place in the request's pool.
    pub cell: usize,
    /// Samples drawn, including those without a scenario.
    pub n_samples: u64,
    /// The bucket that they aimed at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aimed: Option<usize>,
    /// The templates that they followed, each as the bucket it is solved for and its number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tried: Vec<(usize, usize)>,
    /// The number after that of the last sample.
    pub next_sample: usize,
    /// Samples that show the behavior with the requested agents.
    pub n_found: u64,
    /// Found, but in no bucket, or outside the conditions of `where`.
    pub n_outside: u64,
    /// Found, but beyond a limit.
    pub n_beyond_limits: u64,
    /// Found, and in a bucket, by bucket.
    pub hits: BTreeMap<usize, Hits>,
    /// The motion of the requested agents in accepted scenarios.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub accepted_paths: Vec<PairPath>,
    /// The parameters of their events.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub accepted_events: Vec<EventValues>,
}

/// Scenarios of a bucket that meet the request.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hits {
    /// Accepted.
    pub n_accepted: u64,
    /// Not accepted, because the bucket had enough.
    pub n_surplus: u64,
    /// Not accepted, because the bucket had enough from the same scene and agents.
    pub n_repeated: u64,
    /// Not accepted, because the agents move almost as in an accepted one.
    pub n_near_duplicates: u64,
}

impl Hits {
    /// All but near-duplicates, which more samples of the kind would bring, too.
    pub const fn n(&self) -> u64 {
        self.n_accepted + self.n_surplus + self.n_repeated
    }

    fn add(&mut self, other: Self) {
        self.n_accepted += other.n_accepted;
        self.n_surplus += other.n_surplus;
        self.n_repeated += other.n_repeated;
        self.n_near_duplicates += other.n_near_duplicates;
    }
}

/// Counts of one arm, or of its first round.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct ArmCounts {
    pub(super) n_samples: u64,
    pub(super) n_found: u64,
    pub(super) n_outside: u64,
    pub(super) n_beyond_limits: u64,
    pub(super) hits: Vec<Hits>,
    /// By bucket: samples that aimed at it.
    pub(super) aimed: Vec<Aimed>,
}

/// Samples that aimed at a bucket.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Aimed {
    pub(super) n_samples: u64,
    /// Samples that fell into the bucket at which they aimed.
    pub(super) n_hits: u64,
}

/// Counts of one cell over all arms.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct CellCounts {
    /// The buckets that it can reach.
    reaches: Vec<usize>,
    /// How many samples followed each template, by its arm, the bucket it is solved for and its number.
    pub(super) tried: BTreeMap<(usize, usize, usize), u64>,
    /// Samples by arm.
    pub(super) n_samples: Vec<u64>,
    pub(super) next_sample: usize,
    pub(super) hits: BTreeMap<usize, Hits>,
    /// The buckets for which it may still have something.
    open: BTreeMap<usize, InVain>,
}

/// What a cell brought for a bucket since the last accepted sample.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct InVain {
    n_aimed: u64,
    n_near_duplicates: u64,
}

/// The results of a request so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Ledger {
    pub(super) wanted: Vec<u64>,
    /// By bucket: the number of scenarios for which the cells that can reach it have room.
    pub(super) room: Vec<u64>,
    pub(super) max_per_scene: u64,
    pub(super) accepted: Vec<u64>,
    /// By bucket: samples that aimed at it since the last accepted one.
    fruitless: Vec<u64>,
    /// Whether buckets are given up at all.
    gives_up: bool,
    /// Whether no cell has anything more for an open bucket.
    is_exhausted: bool,
    /// Samples and evaluations spent while a bucket was not full.
    pub(super) spent_while_open: Vec<(u64, u64)>,
    pub(super) arms: Vec<ArmCounts>,
    /// [`Self::arms`] for the first round, in which all arms are tried on the same scenes with the same noise.
    pub(super) first_round: Vec<ArmCounts>,
    pub(super) cells: Vec<CellCounts>,
    n_evaluations_by_arm: Vec<u64>,
    behavior: String,
    /// The motion of the requested agents in accepted scenarios.
    paths: PathIndex,
    duplicate_distance_m: f64,
    /// The situation of each cell, and the events and the number of accepted scenarios by bucket in each of them.
    pub(super) situation_of_cell: Vec<usize>,
    situations: Vec<SituationCounts>,
    /// By bucket: the number of cells that may still have something for it.
    n_open: Vec<usize>,
}

/// Accepted scenarios of one situation.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct SituationCounts {
    cells: Vec<usize>,
    events: Vec<EventValues>,
    by_bucket: BTreeMap<usize, u64>,
}

impl Ledger {
    /// The ledger of a request that has not begun.
    pub fn new(request: &ResolvedRequest, pool: &Pool) -> Self {
        let (n_buckets, n_arms) = (request.buckets.len(), request.arms.len());
        let (hits, aimed) = (vec![Hits::default(); n_buckets], vec![Aimed::default(); n_buckets]);
        let counts = ArmCounts { hits, aimed, ..ArmCounts::default() };
        let cell = |reaches: &BTreeMap<usize, f64>| CellCounts {
            reaches: reaches.keys().copied().collect(),
            n_samples: vec![0; n_arms],
            open: reaches.keys().map(|bucket| (*bucket, InVain::default())).collect(),
            ..CellCounts::default()
        };
        let max_per_scene = request.config.max_per_scene;
        let situation_of_cell = pool.situations();
        let n_situations = situation_of_cell.iter().max().map_or(0, |last| last + 1);
        let mut situations = vec![SituationCounts::default(); n_situations];
        for (cell, situation) in situation_of_cell.iter().enumerate() {
            situations[*situation].cells.push(cell);
        }
        Self {
            wanted: request.buckets.wanted().to_vec(),
            room: (0..n_buckets).map(|bucket| max_per_scene.saturating_mul(pool.n_feasible(bucket) as u64)).collect(),
            max_per_scene,
            accepted: vec![0; n_buckets],
            fruitless: vec![0; n_buckets],
            gives_up: request.config.plan == PlanKind::Adaptive,
            is_exhausted: false,
            spent_while_open: vec![(0, 0); n_buckets],
            arms: vec![counts.clone(); n_arms],
            first_round: vec![counts; n_arms],
            cells: pool.feasible.iter().map(cell).collect(),
            n_evaluations_by_arm: request.arms.iter().map(|arm| arm.n_evaluations).collect(),
            behavior: request.config.behavior.clone(),
            paths: PathIndex::default(),
            duplicate_distance_m: request.duplicate_distance_m,
            situation_of_cell,
            situations,
            n_open: (0..n_buckets).map(|bucket| pool.n_feasible(bucket)).collect(),
        }
    }

    /// The number of situations with an accepted scenario.
    pub fn n_situations(&self) -> u64 {
        self.situations.iter().filter(|counts| !counts.by_bucket.is_empty()).count() as u64
    }

    /// Adds a shard. A tally with an unknown arm, cell or bucket belongs to another request and is ignored.
    pub fn add(&mut self, tally: &ShardTally) {
        let Some(n_evaluations) = self.n_evaluations_by_arm.get(tally.arm).copied() else { return };
        let n_samples: u64 = tally.cells.iter().map(|cell| cell.n_samples).sum();
        for bucket in 0..self.wanted.len() {
            if self.is_open(bucket) {
                let (samples, evaluations) = &mut self.spent_while_open[bucket];
                *samples += n_samples;
                *evaluations += n_samples * n_evaluations;
            }
        }
        for cell in &tally.cells {
            let Some(counts) = self.cells.get_mut(cell.cell) else { continue };
            for path in &cell.accepted_paths {
                self.paths.insert(&self.behavior, path.clone(), "");
            }
            if let Some(situation) = self.situation_of_cell.get(cell.cell).and_then(|at| self.situations.get_mut(*at)) {
                situation.events.extend(cell.accepted_events.iter().cloned());
                for (bucket, hits) in cell.hits.iter().filter(|(_, hits)| hits.n_accepted > 0) {
                    *situation.by_bucket.entry(*bucket).or_default() += hits.n_accepted;
                }
            }
            for (bucket, number) in &cell.tried {
                *counts.tried.entry((tally.arm, *bucket, *number)).or_default() += 1;
            }
            counts.n_samples[tally.arm] += cell.n_samples;
            counts.next_sample = counts.next_sample.max(cell.next_sample);
            if let Some(fruitless) = cell.aimed.and_then(|bucket| self.fruitless.get_mut(bucket)) {
                *fruitless += cell.n_samples;
            }
            if let Some(in_vain) = cell.aimed.and_then(|bucket| counts.open.get_mut(&bucket)) {
                in_vain.n_aimed += cell.n_samples;
            }
            for (bucket, hits) in cell.hits.iter().filter(|(bucket, _)| **bucket < self.wanted.len()) {
                counts.hits.entry(*bucket).or_default().add(*hits);
                if let Some(in_vain) = counts.open.get_mut(bucket) {
                    in_vain.n_near_duplicates += hits.n_near_duplicates;
                    if hits.n_accepted > 0 {
                        *in_vain = InVain::default();
                    }
                }
                self.accepted[*bucket] += hits.n_accepted;
                if hits.n_accepted > 0 {
                    self.fruitless[*bucket] = 0;
                }
            }
            self.arms[tally.arm].add(cell);
            if tally.round == 0 {
                self.first_round[tally.arm].add(cell);
            }
            self.close_exhausted(cell.cell);
        }
    }

    /// Closes cells of the situation of this one to buckets for which they have nothing more.
    fn close_exhausted(&mut self, cell: usize) {
        let most_aimed = N_USUAL_HITS / self.usual_rate();
        let Self { situations, cells, n_open, max_per_scene, .. } = self;
        let Some(situation) = self.situation_of_cell.get(cell).map(|idx| &situations[*idx]) else { return };
        for cell in &situation.cells {
            cells[*cell].open.retain(|bucket, in_vain| {
                let n_accepted = situation.by_bucket.get(bucket).copied().unwrap_or_default();
                let is_barren = in_vain.n_near_duplicates >= N_ALIKE || in_vain.n_aimed as f64 >= most_aimed;
                let stays = n_accepted < *max_per_scene && !is_barren;
                n_open[*bucket] -= usize::from(!stays);
                stays
            });
        }
    }

    /// Whether a bucket has fewer scenarios than requested, can get more, and was not given up.
    pub fn is_open(&self, bucket: usize) -> bool {
        self.lacks(bucket) && !self.is_given_up(bucket)
    }

    /// Whether a bucket lacks scenarios but was given up.
    pub fn is_given_up(&self, bucket: usize) -> bool {
        let is_barren = self.is_exhausted || self.fruitless[bucket] >= N_FRUITLESS || self.n_open[bucket] == 0;
        self.gives_up && self.lacks(bucket) && is_barren
    }

    /// Gives up what is open: the last round was tried, although there is more to spend.
    pub fn exhaust(&mut self) {
        self.is_exhausted = true;
    }

    /// How many more scenarios an open bucket takes from the situation of a cell, which may reach it without having
    /// been expected to.
    pub(super) fn room_for(&self, cell: usize, bucket: usize) -> u64 {
        let is_closed = self.cells[cell].reaches.contains(&bucket) && !self.is_open_to(cell, bucket);
        let most = if is_closed || !self.is_open(bucket) { 0 } else { self.max_per_scene };
        most.saturating_sub(self.accepted_of_cell(cell, bucket))
    }

    /// Whether a bucket is open, and a cell may have something for it.
    pub(super) fn is_open_to(&self, cell: usize, bucket: usize) -> bool {
        self.is_open(bucket) && (!self.gives_up || self.cells[cell].open.contains_key(&bucket))
    }

    /// The number of scenarios that an open bucket probably lacks after this many more samples that aim at it.
    pub(super) fn lack_after(&self, n_aimed: u64, bucket: usize) -> f64 {
        let n_lacking = self.wanted[bucket] - self.accepted[bucket];
        // As two samples at the rate of all buckets: what is not known of this one.
        let of_bucket = self.aimed(|other| other == bucket);
        let rate = (2.0 * self.usual_rate() + of_bucket.n_hits as f64) / (2.0 + of_bucket.n_samples as f64);
        n_lacking as f64 - rate * n_aimed as f64
    }

    /// The share of samples that fall into the bucket that they aim at, by Laplace's rule of succession.
    fn usual_rate(&self) -> f64 {
        let Aimed { n_samples, n_hits } = self.aimed(|_| true);
        (1 + n_hits) as f64 / (2 + n_samples) as f64
    }

    /// Samples that aimed at these buckets.
    fn aimed(&self, is_counted: impl Fn(usize) -> bool) -> Aimed {
        let arms = (0..self.arms.len()).map(|arm| self.aimed_of_arm(arm, &is_counted));
        arms.fold(Aimed::default(), |sum, arm| Aimed {
            n_samples: sum.n_samples + arm.n_samples,
            n_hits: sum.n_hits + arm.n_hits,
        })
    }

    fn lacks(&self, bucket: usize) -> bool {
        self.accepted[bucket] < self.wanted[bucket].min(self.room[bucket])
    }

    /// Whether the requested agents move almost as in an accepted scenario, or in one `of_shard` that is not counted
    /// yet.
    pub(super) fn has_like(&self, path: &PairPath, of_shard: &[&PairPath]) -> bool {
        let is_near = |distance_m: f64| distance_m < self.duplicate_distance_m;
        self.paths.nearest(&self.behavior, path).is_some_and(|(_, distance_m)| is_near(distance_m))
            || of_shard.iter().any(|other| is_near(path.distance_m(other)))
    }

    /// Whether an event differs too little from that of an accepted scenario of the same situation, or from one
    /// `of_shard` that is not counted yet.
    pub(super) fn has_like_event(&self, cell: usize, event: &EventValues, of_shard: &[(usize, &EventValues)]) -> bool {
        let Some(situation) = self.situation_of_cell.get(cell) else { return false };
        let known = self.situations.get(*situation).map_or(&[][..], |counts| &counts.events);
        let in_shard = of_shard.iter().filter(|(other, _)| self.situation_of_cell.get(*other) == Some(situation));
        known.iter().chain(in_shard.map(|(_, event)| *event)).any(|other| event.is_like(other))
    }

    /// Whether no bucket is open.
    pub fn is_closed(&self) -> bool {
        (0..self.wanted.len()).all(|bucket| !self.is_open(bucket))
    }

    /// Samples and evaluations spent.
    pub fn spent(&self) -> (u64, u64) {
        let pairs = self.arms.iter().zip(&self.n_evaluations_by_arm);
        pairs.fold((0, 0), |(samples, evaluations), (arm, each)| {
            (samples + arm.n_samples, evaluations + arm.n_samples * each)
        })
    }

    /// Scenarios accepted.
    pub fn n_accepted(&self) -> u64 {
        self.accepted.iter().sum()
    }

    /// Samples of an arm that fell into buckets which are still open.
    pub(super) fn open_hits_of_arm(&self, arm: usize) -> u64 {
        let hits = self.arms[arm].hits.iter().enumerate();
        hits.filter(|(bucket, _)| self.is_open(*bucket)).map(|(_, hits)| hits.n()).sum()
    }

    /// Samples of an arm that aimed at these buckets.
    pub(super) fn aimed_of_arm(&self, arm: usize, is_counted: impl Fn(usize) -> bool) -> Aimed {
        let counted = self.arms[arm].aimed.iter().enumerate().filter(|(bucket, _)| is_counted(*bucket));
        counted.fold(Aimed::default(), |sum, (_, aimed)| Aimed {
            n_samples: sum.n_samples + aimed.n_samples,
            n_hits: sum.n_hits + aimed.n_hits,
        })
    }

    /// Samples of a cell that fell into buckets which are still open and have room for this cell.
    pub(super) fn open_hits_of_cell(&self, cell: usize) -> u64 {
        let hits = self.cells[cell].hits.iter();
        hits.filter(|(bucket, hits)| self.is_open(**bucket) && hits.n_accepted < self.max_per_scene)
            .map(|(_, hits)| hits.n())
            .sum()
    }

    /// Scenarios of the situation of a cell that were accepted in a bucket.
    pub(super) fn accepted_of_cell(&self, cell: usize, bucket: usize) -> u64 {
        let situation = self.situation_of_cell.get(cell).and_then(|at| self.situations.get(*at));
        situation.and_then(|counts| counts.by_bucket.get(&bucket)).copied().unwrap_or_default()
    }
}

impl ArmCounts {
    fn add(&mut self, cell: &CellTally) {
        self.n_samples += cell.n_samples;
        self.n_found += cell.n_found;
        self.n_outside += cell.n_outside;
        self.n_beyond_limits += cell.n_beyond_limits;
        for (bucket, hits) in &cell.hits {
            if let Some(own) = self.hits.get_mut(*bucket) {
                own.add(*hits);
            }
        }
        if let Some((bucket, aimed)) = cell.aimed.and_then(|bucket| Some((bucket, self.aimed.get_mut(bucket)?))) {
            aimed.n_samples += cell.n_samples;
            aimed.n_hits += cell.hits.get(&bucket).map_or(0, Hits::n);
        }
    }
}
