//! Which commands and options are there?

use super::help;
use crate::export::ExportFormat;
use crate::nn::Precision;
use crate::pipeline::DeviceChoice;
use clap::{Parser, Subcommand};
use std::path::PathBuf;

/// Turns traffic recordings into a checked corpus of new scenarios that hold rare events, such as cut-ins.
#[derive(Debug, Parser)]
#[command(name = "djinn", version, after_help = help::TOP, max_term_width = 120)]
pub(super) struct Args {
    #[command(subcommand)]
    pub(super) command: Command,
    #[command(flatten)]
    pub(super) output: OutputArgs,
}

/// What is printed and how fast it goes; for all commands.
#[derive(Debug, clap::Args)]
pub(super) struct OutputArgs {
    /// Print no progress, only results, warnings and errors
    #[arg(short, long, global = true, help_heading = "Global options")]
    pub(super) quiet: bool,
    /// Say more about what is done and why
    #[arg(short, long, global = true, conflicts_with = "quiet", help_heading = "Global options")]
    pub(super) verbose: bool,
    /// Print lines instead of progress bars, as is done where stderr is no terminal
    #[arg(long, global = true, help_heading = "Global options")]
    pub(super) no_progress: bool,
    /// Number of worker threads, 0 for one a core; results do not depend on it
    #[arg(long, value_name = "N", global = true, help_heading = "Global options")]
    pub(super) threads: Option<usize>,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Run all stages of a pipeline file
    #[command(after_help = help::RUN)]
    Run(RunArgs),
    /// Read recordings and write scenes
    #[command(after_help = help::INGEST)]
    Ingest(IngestArgs),
    /// Find behaviors in scenes and write events
    #[command(after_help = help::MINE)]
    Mine(MineArgs),
    /// Train a model on scenes
    #[command(subcommand)]
    Train(TrainCommand),
    /// Sample new scenarios from recorded histories
    #[command(after_help = help::GENERATE)]
    Generate(GenerateArgs),
    /// Measure generated scenarios, check the quality gates and write the corpus
    #[command(after_help = help::EVALUATE)]
    Evaluate(EvaluateArgs),
    /// Write a page for people about what was generated, or compare two runs
    #[command(after_help = help::REPORT, mut_arg("output", not_for_comparisons))]
    Report(ReportArgs),
    /// Check, merge, filter, sample and compare finished corpora
    #[command(subcommand)]
    Corpus(CorpusCommand),
    /// Write a corpus in a format that others read: recordings, simulation, scenario databases
    #[command(after_help = help::EXPORT)]
    Export(ExportArgs),
    /// Generate one scenario again and compare it with its row
    #[command(after_help = help::REGENERATE)]
    Regenerate(RegenerateArgs),
    /// Say what a file or folder of ours holds
    #[command(after_help = help::INSPECT)]
    Inspect(InspectArgs),
}

#[derive(Debug, Subcommand)]
pub(super) enum TrainCommand {
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

#[derive(Debug, Subcommand)]
pub(super) enum CorpusCommand {
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
pub(super) struct CorpusValidateArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR")]
    pub(super) corpus: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct CorpusMergeArgs {
    /// The folders of the corpora, at least two
    #[arg(value_name = "DIR", required = true)]
    pub(super) corpora: Vec<PathBuf>,
    /// The new folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(super) struct CorpusFilterArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR")]
    pub(super) corpus: PathBuf,
    /// A condition such as "gap_m < 5" (may be repeated; all must hold)
    #[arg(long = "where", value_name = "CONDITION", required = true)]
    pub(super) conditions: Vec<String>,
    /// The new folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(super) struct CorpusSampleArgs {
    /// The folder of the corpus
    #[arg(value_name = "DIR")]
    pub(super) corpus: PathBuf,
    /// Number of scenarios
    #[arg(long, value_name = "N")]
    pub(super) n: u64,
    /// A column whose values share the number equally, such as behavior or place
    #[arg(long, value_name = "COLUMN")]
    pub(super) by: Option<String>,
    /// Seed of the draw
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(super) seed: u64,
    /// The new folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(super) struct CorpusDiffArgs {
    /// The folder of the one corpus
    #[arg(value_name = "A")]
    pub(super) a: PathBuf,
    /// The folder of the other
    #[arg(value_name = "B")]
    pub(super) b: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct RunArgs {
    /// The pipeline file
    #[arg(value_name = "PIPELINE.toml")]
    pub(super) pipeline: PathBuf,
    /// Override a value of the file, such as generate.sweeps.0.n_samples=2 (may be repeated)
    #[arg(long, value_name = "KEY=VALUE")]
    pub(super) set: Vec<String>,
    /// Print the resolved configuration and which stages would run, and write nothing
    #[arg(long)]
    pub(super) dry_run: bool,
    /// The folder that holds the folders of all pipelines [default: run.output of the file, or output]
    #[arg(long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Name of the run; the same name again resumes it
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub(super) run: String,
}

/// What every stage takes when it runs alone.
#[derive(Debug, clap::Args)]
pub(super) struct StageArgs {
    /// A pipeline file; the stage's section of it is used [default: the section's defaults]
    #[arg(long, value_name = "PIPELINE.toml")]
    pub(super) config: Option<PathBuf>,
    /// Override a value of the configuration, such as ingest.max_agents=32 (may be repeated)
    #[arg(long, value_name = "KEY=VALUE")]
    pub(super) set: Vec<String>,
    /// Print the resolved configuration and whether the stage would run, and write nothing
    #[arg(long)]
    pub(super) dry_run: bool,
    /// The folder to write into, under the names of a run folder; inputs that are not named are looked for here too
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(super) struct IngestArgs {
    /// Folders, archives or files with recordings [default: ingest.inputs of the configuration]
    pub(super) inputs: Vec<PathBuf>,
    /// The dataset they belong to: interaction, argoverse1 or argoverse2
    #[arg(long)]
    pub(super) dataset: Option<String>,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct MineArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct TrainDenoiserArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct TrainDistillArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) denoiser: DenoiserArg,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct TrainClassifierArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) events: EventsArg,
    #[command(flatten)]
    pub(super) denoiser: DenoiserArg,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct TrainBaselineArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct GenerateArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) denoiser: DenoiserArg,
    /// The folder of a distilled denoiser [default: distilled in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) distilled: Option<PathBuf>,
    /// The folder of a trained classifier [default: classifier in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) classifier: Option<PathBuf>,
    /// The folder of a trained baseline [default: baseline in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) baseline: Option<PathBuf>,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct EvaluateArgs {
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    /// The recorded events, to say how new scenarios are [default: events.parquet in the output folder, where there is one]
    #[arg(long, value_name = "FILE")]
    pub(super) events: Option<PathBuf>,
    /// The folder of generated scenarios [default: samples in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) samples: Option<PathBuf>,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(super) struct ReportArgs {
    /// The folder with the stages' outputs to report on, such as a run folder [default: the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) from: Option<PathBuf>,
    /// Set two runs side by side instead, with their differences
    #[arg(long, num_args = 2, value_names = ["RUN_A", "RUN_B"], conflicts_with_all = ["from", "config", "set", "dry_run"])]
    pub(super) compare: Option<Vec<PathBuf>>,
    /// The page of the comparison [default: comparison.html]
    #[arg(long, value_name = "FILE", requires = "compare")]
    pub(super) out: Option<PathBuf>,
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

/// A comparison names its page itself and writes into no folder of stages.
fn not_for_comparisons(output: clap::Arg) -> clap::Arg {
    output.required(false).required_unless_present("compare").default_value_if(
        "compare",
        clap::builder::ArgPredicate::IsPresent,
        ".",
    )
}

#[derive(Debug, clap::Args)]
pub(super) struct ExportArgs {
    /// The format to write
    #[arg(value_parser = FormatParser)]
    pub(super) format: ExportFormat,
    /// The corpus: the folder that `evaluate` wrote
    #[arg(value_name = "CORPUS")]
    pub(super) corpus: PathBuf,
    /// The folder to write into: a new or an empty one
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Only scenarios in which the behavior that was asked for was found
    #[arg(long)]
    pub(super) only_verified: bool,
    /// Only scenarios that were accepted: verified, valid and no near-duplicates
    #[arg(long)]
    pub(super) only_accepted: bool,
    /// Only scenarios for which this behavior was asked for, such as cut_in
    #[arg(long, value_name = "NAME")]
    pub(super) behavior: Option<String>,
    /// Only scenarios of this sweep
    #[arg(long, value_name = "NAME")]
    pub(super) sweep: Option<String>,
    /// Only the scenario with this id (may be repeated)
    #[arg(long = "scenario", value_name = "ID")]
    pub(super) scenarios: Vec<String>,
    /// At most this many scenarios, the first ones of the corpus
    #[arg(long, value_name = "N", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    pub(super) limit: Option<usize>,
    /// Leave the ego to your driving function: write its start alone (commonroad, openscenario)
    #[arg(long)]
    pub(super) free_ego: bool,
}

/// Reads the name of a format; help and errors list them all.
#[derive(Debug, Clone, Copy)]
pub(super) struct FormatParser;

impl clap::builder::TypedValueParser for FormatParser {
    type Value = ExportFormat;

    fn parse_ref(
        &self,
        command: &clap::Command,
        arg: Option<&clap::Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<Self::Value, clap::Error> {
        let names = clap::builder::PossibleValuesParser::new(ExportFormat::ALL.map(ExportFormat::name));
        let name = names.parse_ref(command, arg, value)?;
        let format = ExportFormat::ALL.into_iter().find(|format| format.name() == name);
        format.ok_or_else(|| clap::Error::new(clap::error::ErrorKind::InvalidValue).with_cmd(command))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = clap::builder::PossibleValue> + '_>> {
        let value = |format: ExportFormat| clap::builder::PossibleValue::new(format.name()).help(format.description());
        Some(Box::new(ExportFormat::ALL.into_iter().map(value)))
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct RegenerateArgs {
    /// The scenario: its scenario_id
    #[arg(value_name = "SCENARIO_ID")]
    pub(super) scenario: String,
    /// The run folder that it was generated in [default: the folder that holds the corpus, or the current one]
    #[arg(long, value_name = "RUN_FOLDER")]
    pub(super) from: Option<PathBuf>,
    /// Compare with its row in this corpus instead of that among the run's samples
    #[arg(long, value_name = "DIR")]
    pub(super) corpus: Option<PathBuf>,
    /// Write what came out into this file, a sample shard of one row
    #[arg(long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
    /// What to compute on: cpu, cuda or cuda:N, as in run.device; only the same kind gives the same bytes
    #[arg(long, default_value_t)]
    pub(super) device: DeviceChoice,
    /// Precision of matrix products: f32, tf32 or bf16, as in run.precision
    #[arg(long, default_value_t)]
    pub(super) precision: Precision,
    #[command(flatten)]
    pub(super) scenes: ScenesArg,
    #[command(flatten)]
    pub(super) denoiser: DenoiserArg,
    /// The folder of the distilled denoiser [default: distilled in the run folder]
    #[arg(long, value_name = "DIR")]
    pub(super) distilled: Option<PathBuf>,
    /// The folder of the classifier [default: classifier in the run folder]
    #[arg(long, value_name = "DIR")]
    pub(super) classifier: Option<PathBuf>,
    /// The folder of the baseline [default: baseline in the run folder]
    #[arg(long, value_name = "DIR")]
    pub(super) baseline: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(super) struct InspectArgs {
    /// A scene store, event table, checkpoint, sample folder or shard, corpus, run folder or report
    pub(super) path: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct ScenesArg {
    /// The scene store to read [default: scenes in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) scenes: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(super) struct EventsArg {
    /// The events to read [default: events.parquet in the output folder]
    #[arg(long, value_name = "FILE")]
    pub(super) events: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(super) struct DenoiserArg {
    /// The folder of a trained denoiser [default: denoiser in the output folder]
    #[arg(long, value_name = "DIR")]
    pub(super) denoiser: Option<PathBuf>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        <Args as clap::CommandFactory>::command().debug_assert();
    }
}
