//! Is a generated scenario what the request asks for, and is there room for it?

use super::facts::Facts;
use super::ledger::{CellTally, Ledger, ShardTally};
use super::resolve::ResolvedRequest;
use super::rounds::{Pool, RoundShard};
use crate::generate::select::Candidate;
use crate::generate::{Cell, Error, Generator};
use crate::store::{BucketTag, RequestOutcome, RequestTag, ScenarioRecord};
use rayon::prelude::*;

/// What of a scenario does not depend on other scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Placement {
    NotFound,
    Outside,
    BeyondLimits(usize),
    Hit(usize),
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
        let own_cell = |record: &ScenarioRecord| {
            let provenance = &record.scenario.provenance;
            let is_own = |cell: &Cell| cell.scene_id == provenance.scene_id && cell.roles == provenance.guidance.roles;
            shard.members.iter().position(|member| is_own(&pool.cells[*member])).ok_or_else(|| Error::Stale {
                scene_id: provenance.scene_id.clone(),
                detail: "a scenario does not belong to any cell of its shard".to_owned(),
            })
        };
        let findings: Vec<(usize, Placement)> = records
            .par_iter()
            .map(|record| {
                let at = own_cell(record)?;
                Ok((at, self.finding(request, &pool.cells[shard.members[at]], record)?))
            })
            .collect::<Result<_, Error>>()?;
        let n_samples = request.arms[shard.arm].n_samples;
        let cell_tally = |cell: &usize| CellTally {
            cell: *cell,
            n_samples: n_samples as u64,
            next_sample: shard.plan.first_sample + n_samples,
            ..CellTally::default()
        };
        let mut tally = ShardTally {
            request: request.config.name.clone(),
            round,
            arm: shard.arm,
            cells: shard.members.iter().map(cell_tally).collect(),
        };
        let mut accepted = ledger.accepted.clone();
        for (record, (at, finding)) in records.iter_mut().zip(findings) {
            let cell = &mut tally.cells[at];
            let (outcome, bucket) = match finding {
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
            };
            cell.n_found += u64::from(outcome != RequestOutcome::NotFound);
            record.request = Some(RequestTag {
                request: request.config.name.clone(),
                round,
                outcome,
                bucket: bucket.map(|idx| BucketTag { idx, ranges: request.buckets.ranges(idx) }),
            });
        }
        Ok(tally)
    }

    fn finding(&self, request: &ResolvedRequest, cell: &Cell, record: &ScenarioRecord) -> Result<Placement, Error> {
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
