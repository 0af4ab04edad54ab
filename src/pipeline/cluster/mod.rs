//! A pipeline on many machines: which jobs does it come to, and how are they handed to an engine that runs them?
//!
//! djinn schedules nothing by itself. [`jobs`] says what is to be run after what, [`slurm`] and [`kubernetes`] hand that to their
//! engines, and as JSON it can be handed to anything else. Whatever is started too early, twice or not at all does no harm: each job looks by itself whether what it
//! reads is there, and what is missing can be made up for by submitting again.

mod config;
mod feed;
mod jobs;
pub mod kubernetes;
#[cfg(test)]
mod kubernetes_tests;
pub mod slurm;
#[cfg(test)]
mod tests;
mod yaml;

pub use config::ClusterConfig;
pub use jobs::{Condition, Dependency, Job, JobGraph, Submission, cautions};

use std::str::FromStr;

/// What runs the jobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Engine {
    /// Slurm, by its commands `sbatch` and `scontrol`.
    Slurm,
    /// Kubernetes with JobSet, by its command `kubectl`.
    Kubernetes,
    /// Anything that reads the graph of jobs.
    Json,
}

impl FromStr for Engine {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "slurm" => Ok(Self::Slurm),
            "kubernetes" => Ok(Self::Kubernetes),
            "json" => Ok(Self::Json),
            _ => Err("expected slurm, kubernetes or json".to_owned()),
        }
    }
}
