//! The commands: what does each do with its arguments?

mod completions;
mod corpus;
mod drive;
mod explain;
mod export;
mod init;
mod inspect;
mod list;
mod man;
mod regenerate;
mod run;
mod stage;
mod status;
mod submit;

pub(super) use completions::completions;
pub(super) use corpus::corpus;
pub(super) use drive::{drive, score};
pub(super) use export::export;
pub(super) use init::init;
pub(super) use inspect::inspect;
pub(super) use list::list;
pub(super) use man::man;
pub(super) use regenerate::regenerate;
pub(super) use run::run;
pub(super) use stage::stage;
pub(super) use status::status;
pub(super) use submit::submit;

use crate::cli::args::OutputArgs;
use crate::cli::printer::Printer;
use crate::cli::signals;
use crate::engine::{Action, Failure, Kept, PlannedStage, Result};
use crate::pipeline::StageId;
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::estimate::estimate;
use crate::pipeline::layout::Layout;
use std::fmt::Write;
use std::path::Path;

/// Advice for when the system refuses another thread.
pub(super) const NO_THREADS: &str =
    "allow the user or the container more processes (`ulimit -u` shows how many), or ask for fewer --threads";

/// Sets up the worker threads: as many as the command line requests, or else as `configured`; 0 for all cores, and
/// never more, because threads that share a core only take turns. rayon keeps one pool for the process, so every
/// command calls this once, before it works.
fn use_threads(output: &OutputArgs, configured: usize) -> Result<()> {
    let n_cores = std::thread::available_parallelism().map_or(usize::MAX, usize::from);
    let n_threads = output.threads.unwrap_or(configured).min(n_cores);
    rayon::ThreadPoolBuilder::new().num_threads(n_threads).build_global().map_err(|error| {
        Failure::fault(anyhow::anyhow!("cannot start the worker threads: {error}")).with_hint(NO_THREADS)
    })
}

/// The refusal of several workers for a run whose results are copied to an object store.
fn no_shared_folder(root: &Path) -> Failure {
    let message = format_args!("{}: workers need a folder that all of them see, not an object store", root.display());
    Failure::input_message(message)
        .with_hint("mount a shared file system, and name a folder on it with --output (pipelines/CLUSTER.md)")
}

/// Sets the message for signals while stages work in a folder, whose work can be resumed.
fn resumes_in(root: &Path) {
    signals::leaves_resumable(format!(
        "finished shards and saved training states are kept in {}; run the same command again to continue",
        root.display()
    ));
}

/// Sets the message for signals while an output is written that appears whole or not at all.
fn begins_anew(out: &Path) {
    signals::leaves(format!(
        "{} is unchanged; unfinished output is beside it under a name that ends in .partial, and can be removed",
        out.display()
    ));
}

/// Prints the configuration as TOML and the plan as comments, so that the output is a pipeline file again.
fn print_dry_run(
    config: &PipelineConfig,
    layout: &Layout,
    planned: &[PlannedStage<'_>],
    printer: &Printer,
) -> Result<()> {
    let mut text = config.to_toml()?;
    text.push_str("\n# Plan:\n");
    for PlannedStage { expected, action, kept, .. } in planned {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "#   {:<18}{action}", expected.stage);
        for Kept { name, as_name } in kept {
            let _ = writeln!(text, "#   {:<18}the current {name} is moved to {as_name}", "");
        }
    }
    // Costs are those of the whole section, whatever parts of it are done already.
    if planned.iter().any(|planned| planned.stage.kind() == StageId::Generate.kind()) {
        for line in estimate(config, layout)? {
            let _ = writeln!(text, "#   {line}");
        }
    }
    printer.data(&text)
}

/// Prints the planned actions of the stages; without `--verbose`, only those on existing results.
fn announce(planned: &[PlannedStage<'_>], output: &OutputArgs, printer: &Printer) {
    for redone in planned.iter().filter_map(PlannedStage::redone) {
        printer.message(redone);
    }
    if !planned.is_empty() && planned.iter().all(|planned| planned.action == Action::Reuse) {
        printer.message("everything is up to date");
    }
    if output.verbose {
        for PlannedStage { expected, action, .. } in planned {
            printer.message(format_args!("{}: {action}, fingerprint {}", expected.stage, expected.fingerprint));
        }
    }
}
