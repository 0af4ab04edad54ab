//! From recorded scenes to new scenarios: what is generated, how is it sampled, and did it do what was asked for?
//!
//! A [`Plan`] fixes everything that is drawn before anything is sampled: which scenes, which pairs of agents, in which
//! shards. A shard depends on the plan, the models and the seed alone, so that shards can be generated in any order, by any
//! number of threads and in any number of attempts, to the same bytes.

mod config;
mod error;
mod generator;
mod guide;
mod pairs;
mod plan;
mod sample;
mod sweep_guidance;
#[cfg(test)]
mod tests;
mod verify;

pub use config::{GenerateConfig, PairRanking, PairSelectionConfig, SweepConfig};
pub use error::Error;
pub use generator::{Generator, Models, SceneLoader};
pub use plan::{Cell, Plan, ShardPlan, Shortfall};
pub use sample::{RejectedSample, ShardOutput};
pub use sweep_guidance::ClassifierScope;
pub use verify::{Verdict, verify};
