//! `djinn run`: all stages of a pipeline file.

use super::{announce, print_dry_run, refuse_too_large, resumes_in, use_threads};
use crate::cli::args::{OutputArgs, RunArgs};
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::layout::Layout;
use crate::pipeline::run::{RunFolder, run_stages};
use crate::pipeline::{Failure, Result, graph, stages};
use crate::settings;

pub(in crate::cli) fn run(args: &RunArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    let mut config = PipelineConfig::load(Some(&args.pipeline), &args.set)?;
    if let Some(folder) = &args.output {
        config.run.output.clone_from(folder);
    }
    use_threads(output, config.run.threads)?;
    for name in [&config.run.name, &args.run] {
        check_folder_name(name)?;
    }
    let root = config.run.output.join(&config.run.name).join(&args.run);
    let layout = Layout::below(&root);
    if args.dry_run {
        let planned = graph::plan(&root, stages::of_pipeline(&config, &layout)?, &args.redo)?;
        refuse_too_large(&config, &layout, &planned)?;
        return print_dry_run(&config, &layout, &planned, printer);
    }
    resumes_in(&root);
    let folder = RunFolder::open(&root)?;
    let planned = graph::plan(&root, stages::of_pipeline(&config, &layout)?, &args.redo)?;
    refuse_too_large(&config, &layout, &planned)?;
    announce(&planned, output, printer);
    let progress = TerminalProgress::new(output, *printer);
    let records = run_stages(&folder, Some(&config), config.run.compute(), planned, &progress)?;
    printer.message(format_args!("results are in {}", root.display()));
    stages::check_gates(&records)
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
