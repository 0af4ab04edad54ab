//! `djinn run`: all stages of a pipeline file.

use super::{announce, print_dry_run, refuse_too_large, resumes_in, use_threads};
use crate::cli::args::{OutputArgs, RunArgs, RunPlace};
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::graph::PlannedStage;
use crate::pipeline::layout::Layout;
use crate::pipeline::parts::{self, Part};
use crate::pipeline::run::{RunFolder, run_stages};
use crate::pipeline::stages::Generate;
use crate::pipeline::{Failure, Result, graph, stages};
use crate::settings;
use std::path::{Path, PathBuf};

pub(in crate::cli) fn run(args: &RunArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    let (config, root) = load(&args.pipeline, &args.set, &args.place)?;
    use_threads(output, config.run.threads)?;
    let layout = Layout::below(&root);
    let plan = || -> Result<Vec<PlannedStage<'_>>> {
        let planned = graph::plan(&root, stages::of_pipeline(&config, &layout)?, &args.redo)?;
        let planned = if args.stage.is_empty() { planned } else { graph::select(planned, &args.stage)? };
        refuse_too_large(&config, &layout, &planned)?;
        Ok(planned)
    };
    if args.dry_run {
        return print_dry_run(&config, &layout, &plan()?, printer);
    }
    resumes_in(&root);
    let progress = TerminalProgress::new(output, *printer);
    let compute = config.run.compute();
    let generation =
        args.part.map(|part| stage_in_parts(args, part, stages::generation(&config, &layout))).transpose()?;
    if let (Some(generate), Some(worker)) = (&generation, args.worker) {
        return parts::work(&root, generate, worker, compute, &progress);
    }
    let folder = RunFolder::open(&root)?;
    let mut planned = plan()?;
    let in_parts = planned.iter_mut().find(|planned| planned.stage.id() == parts::STAGE);
    if let (Some(generate), Some(stage)) = (&generation, in_parts) {
        if args.part == Some(Part::Plan) {
            let is_redone = args.redo.contains(&parts::STAGE);
            return parts::plan(&folder, stage, generate, compute, is_redone, &progress);
        }
        parts::seal(&folder, stage, generate, compute)?;
    }
    announce(&planned, output, printer);
    let records = run_stages(&folder, Some(&config), compute, planned, &progress)?;
    if generation.is_some() {
        parts::sealed(&root)?;
    }
    printer.message(format_args!("results are in {}", root.display()));
    stages::check_gates(&records)
}

/// The stage that is run in parts, if the arguments ask for that as they must.
fn stage_in_parts<'a>(args: &RunArgs, part: Part, generate: Option<Generate<'a>>) -> Result<Generate<'a>> {
    let stage = parts::STAGE;
    if args.stage != [stage] {
        return Err(Failure::input_message(format_args!(
            "--part {part} needs --stage {stage}, the one that has parts"
        )));
    }
    if (part == Part::Work) != args.worker.is_some() {
        return Err(Failure::input_message(format_args!("--worker goes with --part work, not with --part {part}")));
    }
    if part != Part::Plan && !args.redo.is_empty() {
        return Err(Failure::input_message(format_args!("--redo goes with --part plan, not with --part {part}")));
    }
    generate.ok_or_else(|| Failure::input_message("the pipeline has no section [generate]"))
}

/// The configuration and the run folder.
pub(super) fn load(pipeline: &Path, overrides: &[String], place: &RunPlace) -> Result<(PipelineConfig, PathBuf)> {
    let mut config = PipelineConfig::load(Some(pipeline), overrides)?;
    if let Some(folder) = &place.output {
        config.run.output.clone_from(folder);
    }
    for name in [&config.run.name, &place.run] {
        check_folder_name(name)?;
    }
    let root = config.run.output.join(&config.run.name).join(&place.run);
    Ok((config, root))
}

/// The name becomes one folder: nothing that leads elsewhere.
fn check_folder_name(name: &str) -> Result<()> {
    settings::printable_name("the name of a run", name).map_err(Failure::input)?;
    let mut parts = std::path::Path::new(name).components();
    match (parts.next(), parts.next()) {
        (Some(std::path::Component::Normal(_)), None) => Ok(()),
        _ => Err(Failure::input_message(format_args!("`{name}` cannot name a folder of a run"))),
    }
}
