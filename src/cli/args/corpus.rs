//! Arguments of `djinn corpus`.

use super::on_disk;
use crate::cli::help;
use clap::Subcommand;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum CorpusCommand {
    /// Check that a corpus is complete, consistent and physically possible
    #[command(after_help = help::CORPUS_VALIDATE)]
    Validate(CorpusValidateArgs),
    /// Merge several corpora into one
    #[command(after_help = help::CORPUS_MERGE)]
    Merge(CorpusMergeArgs),
    /// Keep the scenarios that meet all conditions
    #[command(after_help = help::CORPUS_FILTER)]
    Filter(CorpusFilterArgs),
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusValidateArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) corpus: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(in crate::cli) json: bool,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusMergeArgs {
    /// The folders of the corpora, at least two
    #[arg(value_name = "DIR", required = true, value_parser = on_disk())]
    pub(in crate::cli) corpora: Vec<PathBuf>,
    /// The folder to write; it must not exist yet
    #[arg(short, long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusFilterArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) corpus: PathBuf,
    /// A condition such as "gap_m < 5" (may be repeated; all must hold)
    #[arg(long = "where", value_name = "CONDITION", required_unless_present_any = ["ids", "top"])]
    pub(in crate::cli) conditions: Vec<String>,
    /// A file with the ids of scenarios, or their beginnings, a line each; - for stdin
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) ids: Option<PathBuf>,
    /// Only the N scenarios with the greatest values of the column --by
    #[arg(long, value_name = "N", requires = "by")]
    pub(in crate::cli) top: Option<usize>,
    /// The column of --top
    #[arg(long, value_name = "COLUMN", requires = "top")]
    pub(in crate::cli) by: Option<String>,
    /// The least values instead of the greatest
    #[arg(long, requires = "top")]
    pub(in crate::cli) least: bool,
    /// The folder to write; it must not exist yet
    #[arg(short, long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) out: PathBuf,
}
