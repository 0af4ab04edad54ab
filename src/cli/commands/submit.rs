//! `djinn submit`: a pipeline as jobs on a cluster.

use super::run::load;
use crate::cli::args::SubmitArgs;
use crate::cli::printer::Printer;
use crate::cloud::ObjectUrl;
use crate::engine::{Failure, Result};
use crate::pipeline::cluster::{Engine, JobGraph, Submission, cautions, slurm};
use crate::pipeline::layout::Layout;
use crate::pipeline::stages;

pub(in crate::cli) fn submit(args: &SubmitArgs, printer: &Printer) -> Result<()> {
    let mut overrides = args.set.clone();
    overrides.extend(args.workers.map(|n_workers| format!("cluster.workers={n_workers}")));
    let (config, root) = load(&args.pipeline, &overrides, &args.place)?;
    let cluster = config.cluster.clone().unwrap_or_default();
    // An impossible pipeline is rejected now instead of by every job.
    stages::of_pipeline(&config, &Layout::below(&root))?.iter().try_for_each(|stage| stage.check())?;
    if ObjectUrl::is_meant(&root) {
        return Err(super::no_shared_folder(&root));
    }
    let submission = Submission {
        pipeline: &args.pipeline,
        overrides: &args.set,
        run: &args.place.run,
        root: &root,
        config: &config,
    };
    let graph = JobGraph::new(&submission, &cluster)?;
    for caution in cautions(&config, &cluster) {
        printer.message(printer.warning_line(&caution));
    }
    match args.engine {
        Engine::Json => {
            let text = serde_json::to_string_pretty(&graph).map_err(Failure::fault)?;
            printer.data(&format!("{text}\n"))
        }
        Engine::Slurm if args.dry_run => printer.data(&slurm::describe(&graph, &cluster)),
        Engine::Slurm => {
            for slurm::Submitted { name, id } in slurm::submit(&graph, &cluster)? {
                printer.data(&format!("{name}\t{id}\n"))?;
            }
            let outputs = slurm::outputs(&graph);
            printer.message(format_args!(
                "results will be in {}, the output of jobs in {}; follow their progress with `djinn status {}`",
                root.display(),
                outputs.display(),
                root.display()
            ));
            Ok(())
        }
    }
}
