//! Arguments of the commands for clusters.

use super::{RunPlace, on_disk};
use crate::pipeline::cluster::Engine;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct SubmitArgs {
    /// The pipeline file
    #[arg(value_name = "PIPELINE.toml")]
    pub(in crate::cli) pipeline: PathBuf,
    /// The scheduler that runs the jobs: slurm, or json to print the graph of jobs for other engines
    #[arg(long, value_name = "ENGINE")]
    pub(in crate::cli) engine: Engine,
    /// Number of jobs that sample, or measure, at once [default: cluster.workers of the file, or 4]
    #[arg(long, value_name = "N")]
    pub(in crate::cli) workers: Option<usize>,
    /// Override a setting, such as cluster.partition=gpu (may be repeated)
    #[arg(long, value_name = "KEY=VALUE")]
    pub(in crate::cli) set: Vec<String>,
    /// Print the scripts; submit nothing
    #[arg(long)]
    pub(in crate::cli) dry_run: bool,
    #[command(flatten)]
    pub(in crate::cli) place: RunPlace,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct StatusArgs {
    /// The run folder
    #[arg(value_name = "RUN_FOLDER", value_parser = on_disk())]
    pub(in crate::cli) run: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(in crate::cli) json: bool,
}
