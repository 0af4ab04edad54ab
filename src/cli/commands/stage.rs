//! The commands that run one stage alone, on explicit inputs and into an explicit folder.

use super::{announce, print_dry_run, resumes_in, use_threads};
use crate::cli::args::{Command, IngestArgs, OutputArgs, RatesArgs, StageArgs, TrainCommand};
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::engine::plan;
use crate::engine::run_folder::{RunFolder, run_stages};
use crate::engine::shards::Makers;
use crate::engine::{Failure, PlannedStage, Result};
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::layout::Layout;
use crate::pipeline::{KINDS, StageId, stages};
use std::collections::BTreeSet;
use std::path::PathBuf;

pub(in crate::cli) fn stage(command: &Command, output: &OutputArgs, printer: &Printer) -> Result<()> {
    let Some(request) = Request::from_command(command) else {
        return Err(Failure::fault(anyhow::anyhow!("this command runs no stage")));
    };
    let Request { id, args, layout, overrides, inputs } = request;
    let overrides = [overrides, args.set.clone()].concat();
    let mut config = PipelineConfig::load(args.config.as_deref(), &overrides)?.with_section(id);
    if let Some(ingest) = config.ingest.as_mut().filter(|ingest| ingest.inputs == in_text(inputs)) {
        ingest.inputs = inputs.to_vec();
    }
    if let Command::Ingest(args) = command
        && args.explain.is_some()
    {
        return super::explain::explain(&config, args, output, printer);
    }
    use_threads(output, config.run.threads)?;
    let root = args.output.as_path();
    let redo = if args.redo { vec![id.kind()] } else { Vec::new() };
    let plan = || -> Result<Vec<PlannedStage<'_>>> {
        let planned = plan::plan(root, &KINDS, vec![stages::alone(id, &config, &layout)?], &redo)?;
        Ok(planned)
    };
    if args.dry_run {
        return print_dry_run(&config, &layout, &plan()?, printer);
    }
    resumes_in(root);
    let progress = TerminalProgress::new(output, *printer);
    let folder = RunFolder::open(root, &KINDS)?;
    let planned = plan()?;
    announce(&planned, output, printer);
    let records = run_stages(&folder, None, (config.run.compute(), Makers::Alone), planned, &progress)?;
    stages::check_gates(&records)
}

/// A stage to run alone.
struct Request<'a> {
    id: StageId,
    args: &'a StageArgs,
    layout: Layout,
    /// Overrides of the configuration by the command's own arguments.
    overrides: Vec<String>,
    /// The recordings given to the command; the overrides have them as text only.
    inputs: &'a [PathBuf],
}

impl<'a> Request<'a> {
    fn new(id: StageId, args: &'a StageArgs) -> Self {
        Self { id, args, layout: Layout::below(&args.output), overrides: Vec::new(), inputs: &[] }
    }

    fn ingest(args: &'a IngestArgs) -> Self {
        let mut request = Self::new(StageId::Ingest, &args.stage);
        if !args.inputs.is_empty() {
            let texts = in_text(&args.inputs)
                .iter()
                .map(|path| toml::Value::String(path.to_string_lossy().into_owned()))
                .collect();
            request.overrides.push(format!("ingest.inputs={}", toml::Value::Array(texts)));
            request.inputs = &args.inputs;
        }
        request.overrides.extend(args.dataset.iter().map(|dataset| format!("ingest.dataset={dataset}")));
        request
    }

    fn from_command(command: &'a Command) -> Option<Self> {
        let request = match command {
            Command::Ingest(args) => Self::ingest(args),
            Command::Mine(args) => Self::new(StageId::Mine, &args.stage).scenes(&args.scenes.scenes),
            Command::Train(TrainCommand::Denoiser(args)) => {
                Self::new(StageId::TrainDenoiser, &args.stage).scenes(&args.scenes.scenes)
            }
            Command::Train(TrainCommand::Distill(args)) => Self::new(StageId::TrainDistill, &args.stage)
                .scenes(&args.scenes.scenes)
                .denoiser(&args.denoiser.denoiser),
            Command::Train(TrainCommand::Classifier(args)) => Self::new(StageId::TrainClassifier, &args.stage)
                .scenes(&args.scenes.scenes)
                .events(&args.events)
                .denoiser(&args.denoiser.denoiser),
            Command::Train(TrainCommand::Baseline(args)) => {
                Self::new(StageId::TrainBaseline, &args.stage).scenes(&args.scenes.scenes)
            }
            Command::Rates(RatesArgs { events, of: args }) => {
                let request = Self::new(StageId::Rates, &args.stage).scenes(&args.scenes.scenes);
                let mut request = request.events(events);
                args.models.replace_in(&mut request.layout);
                request
            }
            Command::Situations(args) | Command::Generate(args) => {
                let id = match command {
                    Command::Situations(_) => StageId::Situations,
                    _ => StageId::Generate,
                };
                let mut request = Self::new(id, &args.stage).scenes(&args.scenes.scenes);
                args.models.replace_in(&mut request.layout);
                request
            }
            Command::Evaluate(args) => {
                let mut request =
                    Self::new(StageId::Evaluate, &args.stage).scenes(&args.scenes.scenes).events(&args.events);
                replace(&mut request.layout.samples, &args.samples);
                request
            }
            Command::Report(args) => {
                let mut request = Self::new(StageId::Report, &args.stage);
                if let Some(folder) = &args.from {
                    request.layout = Layout::below(folder);
                }
                request
            }
            _ => return None,
        };
        Some(request)
    }

    fn scenes(mut self, path: &Option<PathBuf>) -> Self {
        replace(&mut self.layout.scenes, path);
        self
    }

    fn events(mut self, path: &Option<PathBuf>) -> Self {
        replace(&mut self.layout.events, path);
        self
    }

    fn denoiser(mut self, path: &Option<PathBuf>) -> Self {
        replace(&mut self.layout.denoiser, path);
        self
    }
}

fn replace(place: &mut PathBuf, path: &Option<PathBuf>) {
    if let Some(path) = path {
        place.clone_from(path);
    }
}

/// Paths as settings hold them, without duplicates. Settings are UTF-8, which paths need not be.
fn in_text(paths: &[PathBuf]) -> Vec<PathBuf> {
    let texts: BTreeSet<_> = paths.iter().map(|path| path.to_string_lossy()).collect();
    texts.into_iter().map(|text| PathBuf::from(text.into_owned())).collect()
}
