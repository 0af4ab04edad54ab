//! Which commands and options are there?

mod cluster;
mod corpus;
mod drive;
mod export;
mod stages;
mod start;

pub(in crate::cli) use self::cluster::{StatusArgs, SubmitArgs};
pub(in crate::cli) use self::corpus::{CorpusCommand, CorpusFilterArgs};
pub(in crate::cli) use self::drive::{DriveArgs, DriveGates, ScoreArgs};
pub(in crate::cli) use self::export::ExportArgs;
use self::stages::{EvaluateArgs, GenerateArgs, ModelArgs, SceneStageArgs, ScenesArg};
pub(in crate::cli) use self::stages::{IngestArgs, RatesArgs, ReportArgs, StageArgs, TrainCommand};
pub(in crate::cli) use self::start::{CompletionsArgs, InitArgs, ListArgs, Listed, ManArgs};
use super::help;
use crate::cloud::ObjectUrl;
use crate::engine::DeviceChoice;
use crate::engine::shards::{Part, Worker};
use crate::nn::Precision;
use crate::pipeline::StageId;
use clap::builder::{ArgPredicate, PathBufValueParser, RangedU64ValueParser, TypedValueParser};
use clap::{ColorChoice, Parser, Subcommand};
use std::path::PathBuf;

/// Generate verified scenarios of rare traffic events, such as cut-ins, from recordings.
#[derive(Debug, Parser)]
#[command(name = "djinn", version, after_help = help::TOP, max_term_width = 120)]
pub(in crate::cli) struct Args {
    #[command(subcommand)]
    pub(in crate::cli) command: Command,
    #[command(flatten)]
    pub(in crate::cli) output: OutputArgs,
}

/// Options of output and speed, for all commands.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct OutputArgs {
    /// Print results, warnings and errors, but no progress
    #[arg(short, long, global = true, help_heading = "Global options")]
    pub(in crate::cli) quiet: bool,
    /// Print what each stage does and why
    #[arg(short, long, global = true, conflicts_with = "quiet", help_heading = "Global options")]
    pub(in crate::cli) verbose: bool,
    /// Print progress as lines instead of bars (the default when stderr is not a terminal)
    #[arg(long, global = true, help_heading = "Global options")]
    pub(in crate::cli) no_progress: bool,
    /// When messages are colored
    #[arg(long, value_name = "WHEN", global = true, help_heading = "Global options", default_value = "auto")]
    pub(in crate::cli) color: ColorChoice,
    /// Number of worker threads, at most eight a core; 0 uses every core. Results do not depend on it
    #[arg(long, value_name = "N", global = true, help_heading = "Global options", value_parser = up_to(1024))]
    pub(in crate::cli) threads: Option<usize>,
    /// Where to keep what is read from and copied to object stores [default: DJINN_CACHE_DIR, or djinn in the user's
    /// cache folder]
    #[arg(long, value_name = "DIR", global = true, help_heading = "Global options", value_parser = on_disk())]
    pub(in crate::cli) cache_dir: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum Command {
    /// Make a folder with a pipeline to start from, and what it reads
    #[command(after_help = help::INIT)]
    Init(InitArgs),
    /// Run all stages of a pipeline file
    #[command(after_help = help::RUN)]
    Run(RunArgs),
    /// Run a pipeline file as jobs on a cluster
    #[command(after_help = help::SUBMIT)]
    Submit(SubmitArgs),
    /// Show the progress of a run, even while others work on it
    #[command(after_help = help::STATUS)]
    Status(StatusArgs),
    /// Read recordings and write scenes
    #[command(
        after_help = help::INGEST,
        mut_arg("output", |arg| arg.required(false).default_value_if("explain", ArgPredicate::IsPresent, "output"))
    )]
    Ingest(IngestArgs),
    /// Find behaviors in scenes and write events
    #[command(after_help = help::MINE)]
    Mine(SceneStageArgs),
    /// Train a model on scenes
    #[command(subcommand)]
    Train(TrainCommand),
    /// Let held-out scenes go on in closed loops, for rates of what was hardly recorded
    #[command(after_help = help::RATES)]
    Rates(RatesArgs),
    /// Let held-out scenes go on in closed loops, for situations that nobody recorded
    #[command(after_help = help::SITUATIONS)]
    Situations(GenerateArgs),
    /// Sample new scenarios from recorded histories
    #[command(after_help = help::GENERATE)]
    Generate(GenerateArgs),
    /// Measure generated scenarios, check the quality gates and write the corpus
    #[command(after_help = help::EVALUATE)]
    Evaluate(EvaluateArgs),
    /// Write an HTML report of a run
    #[command(after_help = help::REPORT)]
    Report(ReportArgs),
    /// Check, merge and filter finished corpora
    #[command(subcommand)]
    Corpus(CorpusCommand),
    /// Convert a corpus to the format of a dataset, a simulator or a scenario database
    #[command(after_help = help::EXPORT)]
    Export(ExportArgs),
    /// Put a driving function into the scenarios of a corpus, with others that answer to it
    #[command(after_help = help::DRIVE)]
    Drive(DriveArgs),
    /// Score planned trajectories in the scenarios of a corpus, with others that do not answer
    #[command(after_help = help::SCORE)]
    Score(ScoreArgs),
    /// Generate one scenario again and compare it with the stored one
    #[command(after_help = help::REGENERATE)]
    Regenerate(RegenerateArgs),
    /// Summarize a file or folder that djinn wrote
    #[command(after_help = help::INSPECT)]
    Inspect(InspectArgs),
    /// List the behaviors, objectives, datasets, formats or metrics
    #[command(after_help = help::LIST)]
    List(ListArgs),
    /// Print completions for a shell
    #[command(after_help = help::COMPLETIONS)]
    Completions(CompletionsArgs),
    /// Write manual pages
    #[command(after_help = help::MAN)]
    Man(ManArgs),
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct RunArgs {
    /// The pipeline file
    #[arg(value_name = "PIPELINE.toml")]
    pub(in crate::cli) pipeline: PathBuf,
    /// Override a setting, such as generate.sweeps.0.n_samples=2 (may be repeated)
    #[arg(long, value_name = "KEY=VALUE")]
    pub(in crate::cli) set: Vec<String>,
    /// Print the resolved configuration and the stages that would run; write nothing
    #[arg(long)]
    pub(in crate::cli) dry_run: bool,
    /// Rerun this stage, such as train_denoiser, even if it is up to date; a trained model is moved aside (may be
    /// repeated)
    #[arg(long, value_name = "STAGE")]
    pub(in crate::cli) redo: Vec<StageId>,
    /// Run only this stage, such as generate; those it reads from must be done (may be repeated)
    #[arg(long, value_name = "STAGE")]
    pub(in crate::cli) stage: Vec<StageId>,
    /// Run only this part of --stage generate or evaluate: plan, work or seal
    #[arg(long, value_name = "PART", requires = "stage", conflicts_with = "dry_run")]
    pub(in crate::cli) part: Option<Part>,
    /// Which of the workers this is, for --part work; they may run at once, on any number of machines
    #[arg(long, value_name = "K/N", requires = "part", required_if_eq("part", "work"))]
    pub(in crate::cli) worker: Option<Worker>,
    #[command(flatten)]
    pub(in crate::cli) place: RunPlace,
}

/// Where the results of a pipeline go.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct RunPlace {
    /// The folder for the results of all pipelines, or a URL to copy them to [default: run.output of the file, or
    /// output]
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Name of the run; reusing a name resumes that run
    #[arg(long, value_name = "NAME", default_value = "main")]
    pub(in crate::cli) run: String,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct RegenerateArgs {
    /// The scenario's scenario_id
    #[arg(value_name = "SCENARIO_ID")]
    pub(in crate::cli) scenario: String,
    /// The run folder it was generated in [default: the parent of --corpus, or the current folder]
    #[arg(long, value_name = "RUN_FOLDER", value_parser = on_disk())]
    pub(in crate::cli) from: Option<PathBuf>,
    /// Compare with the scenario in this corpus instead of the one in the run's samples
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) corpus: Option<PathBuf>,
    /// Write the new scenario to this file, as a sample shard of one row
    #[arg(long, value_name = "FILE", value_parser = on_disk())]
    pub(in crate::cli) out: Option<PathBuf>,
    /// The device to compute on: cpu, cuda or cuda:N, as in run.device; only the same kind gives the same bytes
    #[arg(long, default_value_t)]
    pub(in crate::cli) device: DeviceChoice,
    /// Precision of matrix products: f32, tf32 or bf16, as in run.precision
    #[arg(long, default_value_t)]
    pub(in crate::cli) precision: Precision,
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) models: ModelArgs,
}

/// Reads a number from 0 to `most`.
fn up_to(most: u64) -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(0..=most)
}

/// Reads a path that cannot be in an object store.
fn on_disk() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match ObjectUrl::is_meant(&path) {
        true => Err("expected a path on disk, not a URL of an object store; copy it from or to there"),
        false => Ok(path),
    })
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct InspectArgs {
    /// A run folder, scene store, event table, checkpoint, sample folder or corpus
    #[arg(value_parser = on_disk())]
    pub(in crate::cli) path: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub(in crate::cli) json: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        <Args as clap::CommandFactory>::command().debug_assert();
    }

    #[test]
    fn examples_fit_on_a_line_where_the_width_is_unknown() {
        fn check(command: &clap::Command) {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            for example in help.lines().filter(|line| line.starts_with("  djinn")) {
                assert!(example.chars().count() <= 100, "{example}");
            }
            command.get_subcommands().for_each(check);
        }
        check(&<Args as clap::CommandFactory>::command());
    }
}
