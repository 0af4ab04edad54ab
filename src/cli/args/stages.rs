//! Arguments of the stages of a pipeline, each run alone.

use crate::cli::help;
use clap::Subcommand;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum TrainCommand {
    /// Train the diffusion model that generates scenarios
    #[command(after_help = help::TRAIN_DENOISER)]
    Denoiser(TrainDenoiserArgs),
    /// Tune a trained diffusion model to need few evaluations
    #[command(after_help = help::TRAIN_DISTILL)]
    Distill(TrainDistillArgs),
    /// Train the classifier that guides generation toward a behavior
    #[command(after_help = help::TRAIN_CLASSIFIER)]
    Classifier(TrainClassifierArgs),
    /// Train Scene Transformer, the baseline to compare the diffusion model with
    #[command(after_help = help::TRAIN_BASELINE)]
    Baseline(TrainBaselineArgs),
}

/// What every stage takes when it runs alone.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct StageArgs {
    /// A pipeline file; the stage's section of it is used [default: the section's defaults]
    #[arg(long, value_name = "PIPELINE.toml")]
    pub(in crate::cli) config: Option<PathBuf>,
    /// Override a setting, such as ingest.max_agents=32 (may be repeated)
    #[arg(long, value_name = "KEY=VALUE")]
    pub(in crate::cli) set: Vec<String>,
    /// Print the resolved configuration and whether the stage would run; write nothing
    #[arg(long)]
    pub(in crate::cli) dry_run: bool,
    /// Rerun the stage even if it is up to date; a trained model is moved aside
    #[arg(long)]
    pub(in crate::cli) redo: bool,
    /// The folder to write to, laid out like a run folder; inputs that are not given are read from here
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct IngestArgs {
    /// Folders, archives or files with recordings [default: ingest.inputs of the configuration]
    pub(in crate::cli) inputs: Vec<PathBuf>,
    /// The dataset they belong to: interaction, argoverse1 or argoverse2
    #[arg(long)]
    pub(in crate::cli) dataset: Option<String>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct MineArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct TrainDenoiserArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct TrainDistillArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) denoiser: DenoiserArg,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct TrainClassifierArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) events: EventsArg,
    #[command(flatten)]
    pub(in crate::cli) denoiser: DenoiserArg,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct TrainBaselineArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct GenerateArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) denoiser: DenoiserArg,
    /// The folder of a distilled denoiser [default: distilled in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) distilled: Option<PathBuf>,
    /// The folder of a trained classifier [default: classifier in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) classifier: Option<PathBuf>,
    /// The folder of a trained baseline [default: baseline in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) baseline: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct EvaluateArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    /// The recorded events, to measure novelty against [default: events.parquet in the output folder, if present]
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) events: Option<PathBuf>,
    /// The folder of generated scenarios [default: samples in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) samples: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ReportArgs {
    /// The folder to report on, such as a run folder [default: the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) from: Option<PathBuf>,
    /// Compare two runs instead
    #[arg(long, num_args = 2, value_names = ["RUN_A", "RUN_B"], conflicts_with_all = ["from", "config", "set", "dry_run", "redo"])]
    pub(in crate::cli) compare: Option<Vec<PathBuf>>,
    /// The file for the comparison [default: comparison.html]
    #[arg(long, value_name = "FILE", requires = "compare")]
    pub(in crate::cli) out: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

/// A comparison names its page itself and writes into no folder of stages.
pub(super) fn not_for_comparisons(output: clap::Arg) -> clap::Arg {
    output.required(false).required_unless_present("compare").default_value_if(
        "compare",
        clap::builder::ArgPredicate::IsPresent,
        ".",
    )
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ScenesArg {
    /// The scene store to read [default: scenes in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) scenes: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct EventsArg {
    /// The events to read [default: events.parquet in the output folder]
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) events: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct DenoiserArg {
    /// The folder of a trained denoiser [default: denoiser in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) denoiser: Option<PathBuf>,
}
