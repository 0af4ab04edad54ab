//! Events by their parameters: what is wanted, what is tried for it, and what has come of that?
//!
//! A request names buckets, arms and a budget ([`RequestConfig`]). Its arms become sweeps ([`ResolvedGeneration`]), a pool of
//! scenes and pairs is fixed ([`Pool`]), and rounds of shards are decided one after the other ([`Round`]), each from what the
//! finished shards of earlier rounds came to ([`Ledger`]). A decision depends on the request, the seed and these counts alone,
//! so that a run that was interrupted decides the same again.

mod buckets;
mod config;
mod draws;
mod facts;
mod judge;
mod ledger;
mod pool;
mod resolve;
mod rounds;
mod summary;
#[cfg(test)]
mod tests;

pub use buckets::{BucketPart, Buckets};
pub use config::{BudgetConfig, Divisions, PlanKind, RequestConfig, Requirement};
pub use judge::PlacedScenario;
pub use ledger::{CellTally, Hits, Ledger, ShardTally};
pub use resolve::{Arm, ResolvedGeneration, ResolvedRequest};
pub use rounds::{Pool, Round, RoundContext, RoundShard};
pub use summary::{ArmSummary, BucketSummary, Ended, RequestSummary, Yield};
