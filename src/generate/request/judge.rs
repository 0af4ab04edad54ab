//! Is a generated scenario what the request asks for, and is there room for it?

use super::facts::Facts;
use super::ledger::{CellTally, Ledger, ShardTally};
use super::resolve::ResolvedRequest;
use super::rounds::{Pool, RoundShard};
use crate::generate::select::Candidate;
use crate::generate::{Cell, Error, Generator};
use crate::store::{BucketTag, RequestOutcome, RequestTag, ScenarioRecord};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What of a scenario does not depend on other scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Placement {
    NotFound,
    Outside,
    BeyondLimits(usize),
    Hit(usize),
}

/// Where a scenario of a shard falls, whatever room there is: enough to decide on it later, in its turn.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlacedScenario {
    /// The place of its cell within the shard.
    cell: usize,
    placement: Placement,
}

impl Generator<'_> {
    /// Tags the records of a finished shard of `request`, in round `round`, with their outcome, and counts them.
    /// `ledger` holds all earlier shards. Scenarios of one cell count in the order of their records.
    ///
    /// # Errors
    /// When a recorded scene cannot be loaded.
    pub fn judge(
        &self,
        (request, round): (&ResolvedRequest, usize),
        (pool, shard): (&Pool, &RoundShard),
        ledger: &Ledger,
        records: &mut [ScenarioRecord],
    ) -> Result<ShardTally, Error> {
        let placed = self.place(request, (pool, shard), records)?;
        let (tally, tags) = request.decide(round, shard, ledger, &placed);
        records.iter_mut().zip(tags).for_each(|(record, tag)| record.request = Some(tag));
        Ok(tally)
    }

    /// Says of the records of a finished shard of `request`, in order, where they fall.
    ///
    /// # Errors
    /// When a recorded scene cannot be loaded.
    pub fn place(
        &self,
        request: &ResolvedRequest,
        (pool, shard): (&Pool, &RoundShard),
        records: &[ScenarioRecord],
    ) -> Result<Vec<PlacedScenario>, Error> {
        let own_cell = |record: &ScenarioRecord| {
            let provenance = &record.scenario.provenance;
            let is_own = |cell: &Cell| cell.scene_id == provenance.scene_id && cell.roles == provenance.guidance.roles;
            shard.members.iter().position(|member| is_own(&pool.cells[*member])).ok_or_else(|| Error::Stale {
                scene_id: provenance.scene_id.clone(),
                detail: "a scenario does not belong to any cell of its shard".to_owned(),
            })
        };
        let place = |record: &ScenarioRecord| {
            let cell = own_cell(record)?;
            let placement = self.placement(request, &pool.cells[shard.members[cell]], record)?;
            Ok(PlacedScenario { cell, placement })
        };
        records.par_iter().map(place).collect()
    }

    fn placement(&self, request: &ResolvedRequest, cell: &Cell, record: &ScenarioRecord) -> Result<Placement, Error> {
        let Some(event) = record.main_event() else { return Ok(Placement::NotFound) };
        let scene = &record.scenario.scene;
        let facts = Facts { scene, event };
        let is_allowed = request.config.conditions.iter().all(|(name, condition)| facts.satisfies(name, condition));
        let Some(bucket) = request.buckets.place(&facts).filter(|_| is_allowed) else { return Ok(Placement::Outside) };
        if request.config.limits.is_empty() {
            return Ok(Placement::Hit(bucket));
        }
        let recorded = self.load(cell.scene_idx, &cell.scene_id)?;
        let asked = &record.scenario.provenance.guidance.roles;
        let asked_to_collide = record.asks_for_collision();
        let candidate = Candidate { scene, objectives: &[], asked, asked_to_collide };
        let verdicts = request.config.limits().verdicts(&recorded, &[candidate], &self.metric_settings);
        let is_valid = verdicts.iter().all(Option::is_none);
        Ok(if is_valid { Placement::Hit(bucket) } else { Placement::BeyondLimits(bucket) })
    }
}

impl ResolvedRequest {
    /// Whether scenarios that were placed so can be of this shard.
    pub fn may_decide(&self, shard: &RoundShard, placed: &[PlacedScenario]) -> bool {
        let is_known = |placement: Placement| match placement {
            Placement::NotFound | Placement::Outside => true,
            Placement::BeyondLimits(bucket) | Placement::Hit(bucket) => bucket < self.buckets.len(),
        };
        placed.iter().all(|scenario| scenario.cell < shard.members.len() && is_known(scenario.placement))
    }

    /// Decides on the scenarios of a shard in round `round`, in their order, when `ledger` holds all earlier shards. Returns the counts, and
    /// the tag of each scenario. What was read from a file is checked by [`ResolvedRequest::may_decide`] first.
    pub fn decide(
        &self,
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
        placed: &[PlacedScenario],
    ) -> (ShardTally, Vec<RequestTag>) {
        let n_samples = self.arms[shard.arm].n_samples;
        let cell_tally = |cell: &usize| CellTally {
            cell: *cell,
            n_samples: n_samples as u64,
            next_sample: shard.plan.first_sample + n_samples,
            ..CellTally::default()
        };
        let mut cells: Vec<CellTally> = shard.members.iter().map(cell_tally).collect();
        let mut accepted = ledger.accepted.clone();
        let mut tags = Vec::new();
        for PlacedScenario { cell, placement } in placed {
            let (outcome, bucket) = outcome(*placement, &mut cells[*cell], ledger, &mut accepted);
            tags.push(RequestTag {
                request: self.config.name.clone(),
                round,
                outcome,
                bucket: bucket.map(|idx| BucketTag { idx, ranges: self.buckets.ranges(idx) }),
            });
        }
        (ShardTally { request: self.config.name.clone(), round, arm: shard.arm, cells }, tags)
    }
}

/// What becomes of a scenario of `cell`, and the bucket that it falls into; counts it.
fn outcome(
    placement: Placement,
    cell: &mut CellTally,
    ledger: &Ledger,
    accepted: &mut [u64],
) -> (RequestOutcome, Option<usize>) {
    cell.n_found += u64::from(placement != Placement::NotFound);
    match placement {
        Placement::NotFound => (RequestOutcome::NotFound, None),
        Placement::Outside => {
            cell.n_outside += 1;
            (RequestOutcome::Outside, None)
        }
        Placement::BeyondLimits(bucket) => {
            cell.n_beyond_limits += 1;
            (RequestOutcome::BeyondLimits, Some(bucket))
        }
        Placement::Hit(bucket) => {
            let hits = cell.hits.entry(bucket).or_default();
            let n_of_cell = ledger.accepted_of_cell(cell.cell, bucket) + hits.n_accepted;
            let outcome = if accepted[bucket] >= ledger.wanted[bucket] {
                hits.n_surplus += 1;
                RequestOutcome::Surplus
            } else if n_of_cell >= ledger.max_per_scene {
                hits.n_repeated += 1;
                RequestOutcome::Repeated
            } else {
                hits.n_accepted += 1;
                accepted[bucket] += 1;
                RequestOutcome::Accepted
            };
            (outcome, Some(bucket))
        }
    }
}
