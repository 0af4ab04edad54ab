//! Generation by any number of processes on a shared folder: who plans, who samples which shard, who publishes?
//!
//! A shard is a function of the plan and its index alone. So there are no leases and no coordinator: a shard that two workers
//! sample costs time, never correctness. One process plans ([`plan`]), workers sample ([`work`]) below
//! `generate.parts/<plan-id>/`, and one process publishes what a single process would have written ([`seal`]). Only the first
//! and the last hold the lock of the run folder and remove anything but their own marks.

mod folder;
mod identity;
mod plan;
mod progress;
mod seal;
#[cfg(test)]
mod tests;
mod tries;
mod work;

pub use identity::Identity;
pub use plan::plan;
pub use progress::{ShardStatus, shard_status};
pub use seal::{seal, sealed};
pub use work::{Worker, work};

use super::stage::StageId;
use std::fmt;
use std::str::FromStr;

/// The stage that can be run in parts.
pub const STAGE: StageId = StageId::Generate;

/// A part of the stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Decides what is sampled: one process.
    Plan,
    /// Samples shards: any number of processes.
    Work,
    /// Publishes the samples: one process.
    Seal,
}

impl FromStr for Part {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = [Self::Plan, Self::Work, Self::Seal].into_iter().find(|part| part.to_string() == name);
        known.ok_or_else(|| "expected plan, work or seal".to_owned())
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Plan => "plan",
            Self::Work => "work",
            Self::Seal => "seal",
        })
    }
}
