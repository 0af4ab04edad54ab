//! Arguments of `djinn corpus`.

use crate::cli::help;
use clap::Subcommand;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum CorpusCommand {
    /// Check that a corpus is whole, fits together and says what can be
    #[command(after_help = help::CORPUS_VALIDATE)]
    Validate(CorpusValidateArgs),
    /// Put several corpora together
    #[command(after_help = help::CORPUS_MERGE)]
    Merge(CorpusMergeArgs),
    /// Keep the scenarios for which conditions hold
    #[command(after_help = help::CORPUS_FILTER)]
    Filter(CorpusFilterArgs),
    /// Draw scenarios at random
    #[command(after_help = help::CORPUS_SAMPLE)]
    Sample(CorpusSampleArgs),
    /// Say what differs between two corpora
    #[command(after_help = help::CORPUS_DIFF)]
    Diff(CorpusDiffArgs),
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusValidateArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR")]
    pub(in crate::cli) corpus: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(in crate::cli) json: bool,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusMergeArgs {
    /// The folders of the corpora, at least two
    #[arg(value_name = "DIR", required = true)]
    pub(in crate::cli) corpora: Vec<PathBuf>,
    /// The new folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusFilterArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR")]
    pub(in crate::cli) corpus: PathBuf,
    /// A condition such as "gap_m < 5" (may be repeated; all must hold)
    #[arg(long = "where", value_name = "CONDITION", required = true)]
    pub(in crate::cli) conditions: Vec<String>,
    /// The new folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusSampleArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR")]
    pub(in crate::cli) corpus: PathBuf,
    /// Number of scenarios
    #[arg(long, value_name = "N")]
    pub(in crate::cli) n: u64,
    /// A column whose values share the number equally, such as behavior or place
    #[arg(long, value_name = "COLUMN")]
    pub(in crate::cli) by: Option<String>,
    /// Seed of the draw
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(in crate::cli) seed: u64,
    /// The new folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct CorpusDiffArgs {
    /// The folder of the one corpus
    #[arg(value_name = "A")]
    pub(in crate::cli) a: PathBuf,
    /// The folder of the other
    #[arg(value_name = "B")]
    pub(in crate::cli) b: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(in crate::cli) json: bool,
}
