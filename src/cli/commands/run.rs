//! `djinn run`: all stages of a pipeline file.

use super::{announce, print_dry_run, resumes_in, use_threads};
use crate::cli::args::{OutputArgs, RunArgs, RunPlace};
use crate::cli::bundled::PIPELINES;
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::cloud::{ObjectUrl, Output};
use crate::engine::plan;
use crate::engine::run_folder::{RunFolder, run_stages};
use crate::engine::shards::{self, Makers, Part};
use crate::engine::{Blame, Failure, PlannedStage, Result, StageRecord};
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::layout::{CORPUS, Layout, REPORT};
use crate::pipeline::{KINDS, StageId, kinds, stages};
use std::path::{Path, PathBuf};

pub(in crate::cli) fn run(args: &RunArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    let in_parts = args.part.map(|part| check_part(args, part)).transpose()?;
    let file = file_of(&args.pipeline, printer)?;
    let (config, root) = load(&file, &args.set, &args.place)?;
    use_threads(output, config.run.threads)?;
    if in_parts.is_some() && ObjectUrl::is_meant(&root) {
        return Err(super::no_shared_folder(&root));
    }
    let place = Output::open(&root, config.recordings())?;
    let outcome = run_in(place.path(), (args, in_parts, &config), output, printer);
    let is_whole = match &outcome {
        Ok(()) => !args.dry_run,
        Err(failure) => failure.blame == Blame::Gate,
    };
    // A failed copy matters more than the message of a gate.
    if is_whole { copy(&place, printer).and(outcome) } else { outcome }
}

/// Copies the results to the object store, if they belong there.
fn copy(place: &Output, printer: &Printer) -> Result<()> {
    let copied = place.copy().map_err(|error| {
        Failure::from(error).with_hint(format!(
            "the results are whole in {}; run the same command again to copy what is missing",
            place.path().display()
        ))
    })?;
    if let Some((url, n)) = copied {
        printer.message(format_args!("the results are copied to {url}; changed files: {n}"));
    }
    Ok(())
}

/// Runs the pipeline in the folder `root`.
fn run_in(
    root: &Path,
    (args, in_parts, config): (&RunArgs, Option<StageId>, &PipelineConfig),
    output: &OutputArgs,
    printer: &Printer,
) -> Result<()> {
    let layout = Layout::below(root);
    let plan = || -> Result<Vec<PlannedStage<'_>>> {
        let planned = plan::plan(root, &KINDS, stages::of_pipeline(config, &layout)?, &kinds(&args.redo))?;
        let planned = if args.stage.is_empty() { planned } else { plan::select(planned, &kinds(&args.stage))? };
        Ok(planned)
    };
    config.remarks().iter().for_each(|remark| printer.message(printer.warning_line(remark)));
    if args.dry_run {
        return print_dry_run(config, &layout, &plan()?, printer);
    }
    resumes_in(root);
    let progress = TerminalProgress::new(output, *printer);
    let compute = config.run.compute();
    if let (Some(id), Some(worker)) = (in_parts, args.worker) {
        return shards::work(stages::alone(id, config, &layout)?.as_ref(), root, worker, compute, &progress);
    }
    let folder = RunFolder::open(root, &KINDS)?;
    let planned = plan()?;
    if args.part == Some(Part::Plan) {
        // The stage is selected, and planning has found it.
        let selected = planned.iter().find(|planned| Some(planned.stage.kind()) == in_parts.map(StageId::kind));
        return selected.map_or(Ok(()), |planned| shards::plan(folder.root(), planned, compute, &progress));
    }
    let makers = if in_parts.is_some() { Makers::Workers } else { Makers::Alone };
    announce(&planned, output, printer);
    let records = run_stages(&folder, Some(&config.about(root)?), (compute, makers), planned, &progress)?;
    describe(&records, root, printer);
    // If a report comes later, the run ends with it.
    if in_parts.is_some() && config.report.is_some() { Ok(()) } else { stages::check_gates(&records) }
}

/// Prints the outcome of the run, and where its results are.
fn describe(records: &[StageRecord], root: &Path, printer: &Printer) {
    let record = |stage: StageId| records.iter().find(|record| record.stage == stage.name());
    if let Some(evaluated) = record(StageId::Evaluate) {
        let count = |key: &str| evaluated.summary[key].as_u64().unwrap_or_default();
        let scenes = match count("n_accepted_scenes") {
            0 => String::new(),
            n => format!(", from {n} scenes"),
        };
        printer.message(format_args!(
            "{} of {} scenarios are accepted ({} verified, {} valid){scenes}",
            count("n_accepted"),
            count("n_scenarios"),
            count("n_verified"),
            count("n_valid")
        ));
        printer.message(format_args!("the corpus is {}", root.join(CORPUS).display()));
    }
    match record(StageId::Report) {
        Some(_) => printer.message(format_args!("the report is {}", root.join(REPORT).display())),
        None => printer.message(format_args!("results are in {}", root.display())),
    }
}

/// The stage to run in parts, if the arguments are valid for that.
fn check_part(args: &RunArgs, part: Part) -> Result<StageId> {
    let &[stage] = args.stage.as_slice() else {
        return Err(Failure::input_message(format_args!("--part {part} goes with one --stage, not with several")));
    };
    if stage.kind().shards.is_none() {
        let with_parts = StageId::ALL.into_iter().filter(|stage| stage.kind().shards.is_some());
        let names: Vec<&str> = with_parts.map(StageId::name).collect();
        return Err(Failure::input_message(format_args!(
            "--part {part} needs --stage {}, which have parts; {stage} has none",
            names.join(" or --stage ")
        )));
    }
    if (part == Part::Work) != args.worker.is_some() {
        return Err(Failure::input_message(format_args!("--worker goes with --part work, not with --part {part}")));
    }
    if part != Part::Plan && !args.redo.is_empty() {
        return Err(Failure::input_message(format_args!("--redo goes with --part plan, not with --part {part}")));
    }
    Ok(stage)
}

/// The file of a pipeline. A bundled one may be given by its name, and is written below the current directory before it
/// runs for the first time.
fn file_of(pipeline: &Path, printer: &Printer) -> Result<PathBuf> {
    let is_meant = |(name, _): &&(&str, &str)| pipeline == Path::new(name) && !pipeline.is_file();
    let Some((name, _)) = PIPELINES.iter().find(is_meant) else { return Ok(pipeline.to_owned()) };
    let file = pipeline.join(format!("{name}.toml"));
    if !file.is_file() {
        super::init::write(pipeline, name, printer)?;
    }
    Ok(file)
}

/// Loads the configuration and finds the run folder.
pub(super) fn load(pipeline: &Path, overrides: &[String], place: &RunPlace) -> Result<(PipelineConfig, PathBuf)> {
    let mut config = PipelineConfig::load(Some(pipeline), overrides)?;
    if let Some(folder) = &place.output {
        config.run.output.clone_from(folder);
    }
    let root = config.folder_of(&place.run)?;
    Ok((config, root))
}
