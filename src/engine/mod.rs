//! Runs stages in a folder: which must run, which are reused or resumed, and whose files are whose?
//!
//! The engine knows nothing of what stages do. A [`Stage`] names its configuration, inputs and outputs, and does its
//! work as a whole or in shards ([`Work`]). [`plan`] decides on the action for each of them, [`run_folder`] runs them
//! and keeps the folder's records, [`shards`] lets several processes make the shards of one stage.
//!
//! - A stage works in `<stage>.partial`; outputs are put in place only once they are whole, and a process that is
//!   killed at any moment leaves a folder in which the same command goes on.
//! - The record of a finished stage tells what it was made from and which files it wrote. Nothing else is ever replaced
//!   or removed.
//! - Decisions are made while the folder is locked, so that they hold until they are carried out.

mod clock;
mod device;
mod earlier;
mod earlier_runs;
mod execute;
mod failure;
mod fingerprint;
mod inputs;
mod kept_models;
mod kind;
mod log;
mod outdated;
mod ownership;
pub mod plan;
#[cfg(test)]
mod plan_tests;
mod planned;
mod record;
mod revision;
pub mod run_folder;
#[cfg(test)]
mod safety_tests;
pub mod shards;
mod stage;
#[cfg(test)]
mod testing;
mod timings;
mod work_folder;

pub use clock::Stopwatch;
pub use device::{ComputeChoice, DeviceChoice};
pub use earlier_runs::begun;
pub use failure::{Blame, Classify, Failure, Result};
pub use fingerprint::{PathFingerprint, fingerprint_path, fingerprint_value};
pub use kept_models::Kept;
pub use kind::{ShardNames, StageInput, StageKind};
pub use planned::{Action, PlannedStage};
pub use record::{InputRecord, StageRecord, done_path};
pub use revision::version;
pub use stage::{Stage, StageContext, Whole, Work};
pub use work_folder::work_path;
