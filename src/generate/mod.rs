//! From recorded scenes to new scenarios: what is generated, how is it sampled, and does it show the requested
//! behavior?
//!
//! A [`Plan`] fixes everything that is drawn before anything is sampled: which scenes, which pairs of agents, in which
//! shards. A shard depends on the plan, the models and the seed alone, so shards can be generated in any order, by any
//! number of threads and in any number of attempts, to the same bytes.
//!
//! `SweepConfig` is a sweep or an arm as written; all later code works on `ResolvedSweep`, which was checked once and
//! cannot contradict itself. `request` plans rounds of shards by Thompson sampling on the counts of finished shards; a
//! round is written to a file before its shards are sampled. `regenerate` samples one scenario again in its original
//! batch: matrix products of few rows round differently from those of many.

mod baseline;
#[cfg(test)]
mod baseline_tests;
mod batch;
mod cell;
mod conditioning;
#[cfg(test)]
mod conditioning_tests;
mod config;
mod error;
mod futures;
mod generator;
mod guide;
mod observe;
mod pair_selection;
mod pairs;
mod plan;
mod record;
mod regenerate;
mod request;
mod rollout;
mod sample;
mod sweep;
mod targets;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod verify;

pub use cell::Cell;
pub use config::GenerateConfig;
pub use error::Error;
pub use futures::{Continued, Futures};
pub use generator::{Generator, Models, SceneLoader};
pub use observe::{AgentChoice, MaskRule, ObserveConfig, SecondRange, TimeChoice};
pub use pair_selection::{PairRanking, PairSelectionConfig};
pub use plan::{Plan, ShardPlan, Shortfall, held_out_in_order};
pub use regenerate::SampleKey;
pub use request::{
    Arm, ArmSummary, BucketPart, BucketSummary, Buckets, BudgetConfig, CellAim, CellTally, Divisions, Ended,
    EventValues, Hits, KnownTemplates, Ledger, Limit, LimitRange, PlacedScenario, PlanKind, Pool, RequestConfig,
    RequestSummary, Requirement, ResolvedGeneration, ResolvedRequest, Round, RoundContext, RoundShard, ShardTally,
    Shown, Templates, Yield,
};
pub use rollout::{NamedDriver, SweepRollout, check_times};
pub use sample::{RejectedSample, Rejection, ShardOutput};
pub use sweep::{
    Aim, ClassifierFreeConfig, ClassifierScope, Diffusion, EditConfig, ResolvedSweep, SampledModel, SweepConfig,
    SweepGuidance, SweepModel,
};
pub use verify::requested_events;
