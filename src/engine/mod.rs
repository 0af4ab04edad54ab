//! Runs stages in a folder: which must run, which can be reused, which resume, and whose files are whose?
//!
//! The engine knows nothing of what stages do. A [`Stage`] names its configuration, inputs and outputs, and does its
//! work as a whole or in shards ([`Work`]). [`plan`] decides what is to be done about each of them, [`run_folder`] runs
//! them and keeps the folder's records, [`shards`] lets several processes make the shards of one stage.
//!
//! - A stage works in `<stage>.partial`; outputs come to their places only once they are whole, and a process that is
//!   killed at any moment leaves a folder in which the same command goes on.
//! - A record of every finished stage says from what it was made and which files it wrote. Nothing else is ever
//!   replaced or removed.
//! - Decisions are made while the folder is locked, so that they hold until they are carried out.

mod clock;
mod device;
mod execute;
mod failure;
mod fingerprint;
mod kept_models;
mod kind;
mod log;
mod outdated;
mod ownership;
pub mod plan;
#[cfg(test)]
mod plan_tests;
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

pub use device::{ComputeChoice, DeviceChoice};
pub use failure::{Blame, Classify, Failure, Result};
pub use fingerprint::{PathFingerprint, fingerprint_path, fingerprint_value};
pub use kept_models::Kept;
pub use kind::{ShardNames, StageKind};
pub use record::{InputRecord, StageRecord, done_path};
pub use revision::version;
pub use stage::{Stage, StageContext, StageInput, Whole, Work};
pub use work_folder::work_path;
