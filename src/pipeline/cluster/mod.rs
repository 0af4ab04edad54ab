//! A pipeline on many machines: which jobs does it need, and how are they submitted to an engine that runs them?
//!
//! djinn schedules nothing by itself. `jobs` defines the jobs and their dependencies, [`slurm`] submits them,
//! and JSON serves any other engine. A job that is started too early or twice does no
//! harm, because each job checks for itself that its inputs exist. Submitting again makes up for jobs that never ran.

mod config;
mod feed;
mod jobs;
pub mod slurm;
#[cfg(test)]
mod tests;

pub use config::ClusterConfig;
pub use jobs::{Completion, Dependency, Job, JobGraph, Submission, cautions};

use crate::settings::Unreadable;
use std::str::FromStr;

/// The engine that runs the jobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Engine {
    /// Slurm, through its commands `sbatch` and `scontrol`.
    Slurm,
    /// Anything that reads the graph of jobs.
    Json,
}

impl FromStr for Engine {
    type Err = Unreadable;

    fn from_str(name: &str) -> Result<Self, Unreadable> {
        match name {
            "slurm" => Ok(Self::Slurm),
            "json" => Ok(Self::Json),
            _ => Err("expected slurm or json".into()),
        }
    }
}
