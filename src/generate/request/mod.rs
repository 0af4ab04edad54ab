//! Requests for events by their parameters: what is requested, what is tried, and with what results?
//!
//! A request names buckets, arms and a budget ([`RequestConfig`]). Its arms become sweeps ([`ResolvedGeneration`]), a
//! pool of scenes and pairs is fixed ([`Pool`]), and rounds of shards are decided one after the other ([`Round`]), each
//! from the results of earlier rounds ([`Ledger`]) and, where samples follow templates, from what these show by
//! themselves ([`Shown`]). A decision depends only on the request, the seed, these counts and the scenes, so that an
//! interrupted run makes the same decisions again.

mod buckets;
mod config;
mod draws;
mod event_values;
mod facts;
mod judge;
mod ledger;
mod limits;
mod pool;
mod resolve;
mod rounds;
mod shown;
mod summary;
#[cfg(test)]
mod tests;

pub use buckets::{BucketPart, Buckets};
pub use config::{BudgetConfig, Divisions, PlanKind, RequestConfig, Requirement};
pub use event_values::EventValues;
pub use judge::PlacedScenario;
pub use ledger::{CellTally, Hits, Ledger, ShardTally};
pub use limits::{Limit, LimitRange};
pub use pool::Pool;
pub use resolve::{Arm, ResolvedGeneration, ResolvedRequest};
pub use rounds::{CellAim, Round, RoundContext, RoundShard};
pub use shown::{KnownTemplates, Shown, Templates};
pub use summary::{ArmSummary, BucketSummary, Ended, RequestSummary, Yield};
