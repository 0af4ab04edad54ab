//! The pipeline: which stages are there, which must run, and where do their results lie?
//!
//! [`config`] reads a pipeline file, [`stages`] connects the sections to the domain code, [`graph`] decides what must run
//! and runs it, [`run`] keeps the run folder, [`compare`] sets two of them side by side. [`shards`] lets several processes work on one
//! stage, [`cluster`] hands them to an engine, [`status`] tells how far they are. Only this module (and the command line) uses `anyhow`.

mod claim;
mod clock;
pub mod cluster;
pub mod compare;
pub mod config;
mod device;
pub mod estimate;
mod failure;
mod fingerprint;
pub mod graph;
#[cfg(test)]
mod graph_tests;
pub mod inspect;
mod keep;
pub mod layout;
mod log;
pub mod memory;
mod record;
pub mod regenerate;
pub mod run;
#[cfg(test)]
mod safety_tests;
pub mod shards;
mod stage;
mod stage_facts;
pub mod stages;
mod stale;
pub mod status;
mod work;

pub use device::{ComputeChoice, DeviceChoice};
pub use failure::{Blame, Classify, Failure, Result};
pub use fingerprint::{PathFingerprint, fingerprint_path};
pub use keep::Kept;
pub use record::{InputRecord, StageRecord};
pub use stage::{Stage, StageContext, StageId, StageInput, Whole, Work};
pub use stage_facts::{ShardFacts, StageFacts, StageOutput};
