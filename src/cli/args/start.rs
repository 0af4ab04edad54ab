//! Arguments of the commands that help to start: `init`, `list`, `completions`.

use super::on_disk;
use crate::cli::bundled::PIPELINES;
use clap::ValueEnum;
use clap::builder::PossibleValuesParser;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct InitArgs {
    /// The folder to write; it must be new or empty
    #[arg(value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) dir: PathBuf,
    /// The pipeline to start from
    #[arg(default_value = PIPELINES[0].0, value_parser = PossibleValuesParser::new(PIPELINES.map(|(name, _)| name)))]
    pub(in crate::cli) pipeline: String,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ListArgs {
    /// What to list
    #[arg(value_enum)]
    pub(in crate::cli) what: Listed,
}

/// What a pipeline, a command or a table can name.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(in crate::cli) enum Listed {
    /// Events to mine, to request and to verify
    Behaviors,
    /// Goals and rules that sampled trajectories are pushed toward
    Objectives,
    /// Datasets whose recordings are read
    Datasets,
    /// Formats to which a corpus is exported
    Formats,
    /// Metrics of generated and recorded traffic
    Metrics,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ManArgs {
    /// The folder to write; it must be new or empty
    #[arg(value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) dir: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub(in crate::cli) shell: clap_complete::Shell,
}
