//! Requested and delivered: the figures of a request, for `requests.json` and the report.

use super::buckets::BucketPart;
use super::config::BudgetConfig;
use super::ledger::{ArmCounts, Hits, Ledger};
use super::pool::Pool;
use super::resolve::ResolvedRequest;
use crate::scene::GuidanceLevel;
use serde::{Deserialize, Serialize};

/// Why a request was ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// Every bucket that any pair can reach is full.
    Full,
    /// The remaining buckets were given up: many samples aimed at them, and none was accepted.
    GivenUp,
    /// The budget is spent; some buckets stayed short.
    Budget,
}

/// Requested and delivered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RequestSummary {
    /// Name of the request.
    pub name: String,
    /// The behavior.
    pub behavior: String,
    /// Why it was ended.
    pub ended: Ended,
    /// Its budget.
    pub budget: BudgetConfig,
    /// The number of rounds.
    pub n_rounds: usize,
    /// Samples drawn.
    pub n_samples: u64,
    /// Evaluations of the denoiser.
    pub n_evaluations: u64,
    /// Scenes that were tried.
    pub n_scenes: usize,
    /// Pairs of agents (or single agents) in them that can reach a bucket.
    pub n_cells: usize,
    /// Pairs that cannot reach a bucket and were not tried.
    pub n_infeasible: usize,
    /// Scenarios requested in all.
    pub n_wanted: u64,
    /// Scenarios accepted.
    pub n_accepted: u64,
    /// Situations in which they begin: different agents, or moments three seconds apart.
    pub n_situations: u64,
    /// The arms.
    pub arms: Vec<ArmSummary>,
    /// The buckets.
    pub buckets: Vec<BucketSummary>,
}

/// The results of an arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArmSummary {
    /// Its name.
    pub name: String,
    /// The level of guidance of its samples.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// Evaluations of the denoiser for one sample.
    pub n_evaluations_per_sample: u64,
    /// Samples that aimed at a bucket, over all rounds.
    pub n_aimed: u64,
    /// Samples among them that fell into the bucket at which they aimed.
    pub n_aimed_hits: u64,
    /// Yield of all rounds; arms and scenes with a higher yield are tried more often.
    pub total: Yield,
    /// Yield of the first round, in which every arm continues the same scenes from the same noise.
    pub first_round: Yield,
}

/// Samples by outcome.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Yield {
    /// Samples.
    pub n_samples: u64,
    /// Samples that show the behavior with the requested agents.
    pub n_found: u64,
    /// Found, but outside of all buckets and conditions.
    pub n_outside: u64,
    /// Found, but beyond a limit.
    pub n_beyond_limits: u64,
    /// Found, and in a bucket, accepted or not, near-duplicates aside.
    pub n_hits: u64,
    /// Accepted.
    pub n_accepted: u64,
}

/// The results of a bucket.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BucketSummary {
    /// Its index, as in the column `bucket`.
    pub idx: usize,
    /// The range of each parameter.
    pub parts: Vec<BucketPart>,
    /// Pairs of agents that can reach it; 0: nothing was spent on it.
    pub n_feasible: usize,
    /// Whether it was given up: many samples aimed at it in a row, and none was accepted, or no pair has more for it.
    pub is_given_up: bool,
    /// Scenarios requested.
    pub n_wanted: u64,
    /// Scenarios accepted.
    pub n_accepted: u64,
    /// Not accepted, because the bucket had enough.
    pub n_surplus: u64,
    /// Not accepted, because it had enough from the same scene and agents.
    pub n_repeated: u64,
    /// Not accepted, because the agents move almost as in an accepted one.
    pub n_near_duplicates: u64,
    /// Accepted scenarios by arm.
    pub accepted_by_arm: Vec<u64>,
    /// Scenarios in it by arm, accepted or not, near-duplicates aside.
    pub hits_by_arm: Vec<u64>,
    /// [`Self::hits_by_arm`] for the first round.
    pub first_round_hits_by_arm: Vec<u64>,
    /// Samples drawn, for all buckets together, while this one was not full.
    pub n_samples_while_open: u64,
    /// Evaluations of the denoiser for them.
    pub n_evaluations_while_open: u64,
}

impl BucketSummary {
    /// Evaluations per accepted scenario, counted while the bucket was open; other open buckets share them.
    pub fn n_evaluations_per_accepted(&self) -> Option<f64> {
        (self.n_accepted > 0).then(|| self.n_evaluations_while_open as f64 / self.n_accepted as f64)
    }
}

impl RequestSummary {
    /// The summary of a request that ended after `n_rounds` rounds.
    pub fn new(request: &ResolvedRequest, pool: &Pool, ledger: &Ledger, n_rounds: usize) -> Self {
        let (n_samples, n_evaluations) = ledger.spent();
        let arms = request.arms.iter().enumerate().map(|(i, arm)| ArmSummary {
            name: arm.name.clone(),
            level: arm.level,
            n_evaluations_per_sample: arm.n_evaluations,
            n_aimed: ledger.aimed_of_arm(i, |_| true).n_samples,
            n_aimed_hits: ledger.aimed_of_arm(i, |_| true).n_hits,
            total: Yield::of(&ledger.arms[i]),
            first_round: Yield::of(&ledger.first_round[i]),
        });
        let bucket = |idx: usize| {
            let by_arm = |counts: &[ArmCounts], of: fn(&Hits) -> u64| -> Vec<u64> {
                counts.iter().map(|arm| of(&arm.hits[idx])).collect()
            };
            let sum = |of: fn(&Hits) -> u64| by_arm(&ledger.arms, of).iter().sum();
            let (n_samples_while_open, n_evaluations_while_open) = ledger.spent_while_open[idx];
            BucketSummary {
                idx,
                parts: request.buckets.parts(idx),
                n_feasible: pool.n_feasible(idx),
                is_given_up: ledger.is_given_up(idx),
                n_wanted: ledger.wanted[idx],
                n_accepted: ledger.accepted[idx],
                n_surplus: sum(|hits| hits.n_surplus),
                n_repeated: sum(|hits| hits.n_repeated),
                n_near_duplicates: sum(|hits| hits.n_near_duplicates),
                accepted_by_arm: by_arm(&ledger.arms, |hits| hits.n_accepted),
                hits_by_arm: by_arm(&ledger.arms, Hits::n),
                first_round_hits_by_arm: by_arm(&ledger.first_round, Hits::n),
                n_samples_while_open,
                n_evaluations_while_open,
            }
        };
        Self {
            name: request.config.name.clone(),
            behavior: request.config.behavior.clone(),
            ended: match (0..request.buckets.len()).any(|bucket| ledger.is_given_up(bucket)) {
                _ if !ledger.is_closed() => Ended::Budget,
                true => Ended::GivenUp,
                false => Ended::Full,
            },
            budget: request.config.budget,
            n_rounds,
            n_samples,
            n_evaluations,
            n_scenes: pool.n_scenes,
            n_cells: pool.cells.len(),
            n_infeasible: pool.n_infeasible,
            n_wanted: ledger.wanted.iter().sum(),
            n_accepted: ledger.n_accepted(),
            n_situations: ledger.n_situations(),
            arms: arms.collect(),
            buckets: (0..request.buckets.len()).map(bucket).collect(),
        }
    }

    /// Buckets that no pair can reach.
    pub fn infeasible(&self) -> impl Iterator<Item = &BucketSummary> {
        self.buckets.iter().filter(|bucket| bucket.n_feasible == 0)
    }

    /// Buckets that were given up.
    pub fn given_up(&self) -> impl Iterator<Item = &BucketSummary> {
        self.buckets.iter().filter(|bucket| bucket.is_given_up)
    }

    /// Buckets that stayed short, infeasible ones among them.
    pub fn short(&self) -> impl Iterator<Item = &BucketSummary> {
        self.buckets.iter().filter(|bucket| bucket.n_accepted < bucket.n_wanted)
    }
}

impl Yield {
    fn of(counts: &ArmCounts) -> Self {
        Self {
            n_samples: counts.n_samples,
            n_found: counts.n_found,
            n_outside: counts.n_outside,
            n_beyond_limits: counts.n_beyond_limits,
            n_hits: counts.hits.iter().map(Hits::n).sum(),
            n_accepted: counts.hits.iter().map(|hits| hits.n_accepted).sum(),
        }
    }
}
