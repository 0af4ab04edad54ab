//! Arguments of the stages of a pipeline, each run alone.

use super::on_disk;
use crate::cli::help;
use crate::pipeline::layout::Layout;
use crate::scene::Dataset;
use clap::Subcommand;
use clap::builder::PossibleValuesParser;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum TrainCommand {
    /// Train the diffusion model that generates scenarios
    #[command(after_help = help::TRAIN_DENOISER)]
    Denoiser(SceneStageArgs),
    /// Tune a trained diffusion model to need few evaluations
    #[command(after_help = help::TRAIN_DISTILL)]
    Distill(TrainDistillArgs),
    /// Train the classifier that guides generation toward a behavior
    #[command(after_help = help::TRAIN_CLASSIFIER)]
    Classifier(TrainClassifierArgs),
    /// Train Scene Transformer, the baseline to compare the diffusion model with
    #[command(after_help = help::TRAIN_BASELINE)]
    Baseline(SceneStageArgs),
}

/// Arguments of every stage that runs alone.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct StageArgs {
    /// A pipeline file; the stage's section of it is used [default: the section's defaults]
    #[arg(long, value_name = "PIPELINE.toml", value_parser = on_disk())]
    pub(in crate::cli) config: Option<PathBuf>,
    /// Override a setting, such as run.seed=7 (may be repeated)
    #[arg(long, value_name = "KEY=VALUE")]
    pub(in crate::cli) set: Vec<String>,
    /// Print the resolved configuration and whether the stage would run; write nothing
    #[arg(long)]
    pub(in crate::cli) dry_run: bool,
    /// Rerun the stage even if it is up to date; a trained model is moved aside
    #[arg(long)]
    pub(in crate::cli) redo: bool,
    /// The run folder: results are written to it, and inputs that are not given are read from it
    #[arg(short, long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) output: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct IngestArgs {
    /// Folders, archives or files with recordings [default: ingest.inputs of the configuration]
    pub(in crate::cli) inputs: Vec<PathBuf>,
    /// The dataset they belong to
    #[arg(long, value_parser = PossibleValuesParser::new(Dataset::ALL.map(Dataset::name)))]
    pub(in crate::cli) dataset: Option<String>,
    /// Print what is understood of the first recordings, and write nothing but a picture of the first scene, if named
    #[arg(long, value_name = "PICTURE.svg", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    pub(in crate::cli) explain: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

/// Arguments of a stage that reads scenes and nothing else.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct SceneStageArgs {
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
    /// The events to read [default: events.parquet in the run folder]
    #[arg(long, value_name = "FILE", value_parser = on_disk())]
    pub(in crate::cli) events: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) denoiser: DenoiserArg,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct GenerateArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    #[command(flatten)]
    pub(in crate::cli) models: ModelArgs,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct RatesArgs {
    /// The recorded events to compare with; exposure.parquet and occurrences.parquet are beside them [default:
    /// events.parquet in the run folder]
    #[arg(long, value_name = "FILE", value_parser = on_disk())]
    pub(in crate::cli) events: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) of: GenerateArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct EvaluateArgs {
    #[command(flatten)]
    pub(in crate::cli) scenes: ScenesArg,
    /// The recorded events, to measure novelty against [default: events.parquet in the run folder, if present]
    #[arg(long, value_name = "FILE", value_parser = on_disk())]
    pub(in crate::cli) events: Option<PathBuf>,
    /// The folder of generated scenarios [default: samples in the run folder]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) samples: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ReportArgs {
    /// The run folder to report on [default: --output]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) from: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) stage: StageArgs,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ScenesArg {
    /// The scene store to read [default: scenes in the run folder]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) scenes: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct DenoiserArg {
    /// The folder of a trained denoiser [default: denoiser in the run folder]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) denoiser: Option<PathBuf>,
}

/// The models that scenarios are sampled with.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ModelArgs {
    #[command(flatten)]
    denoiser: DenoiserArg,
    /// The folder of a distilled denoiser [default: distilled in the run folder]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    distilled: Option<PathBuf>,
    /// The folder of a trained classifier [default: classifier in the run folder]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    classifier: Option<PathBuf>,
    /// The folder of a trained baseline [default: baseline in the run folder]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    baseline: Option<PathBuf>,
}

impl ModelArgs {
    /// Puts the folders that are given in the place of the run's.
    pub(in crate::cli) fn replace_in(&self, layout: &mut Layout) {
        for (place, path) in [
            (&mut layout.denoiser, &self.denoiser.denoiser),
            (&mut layout.distilled, &self.distilled),
            (&mut layout.classifier, &self.classifier),
            (&mut layout.baseline, &self.baseline),
        ] {
            path.iter().for_each(|path| place.clone_from(path));
        }
    }
}
