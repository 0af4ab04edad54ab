//! `djinn export`: a corpus in a format of other programs.

use crate::cli::args::{ExportArgs, OutputArgs};
use crate::cli::printer::{Printer, stderr_line};
use crate::cli::progress::TerminalProgress;
use crate::engine::{Failure, Result};
use crate::export::{EgoMotion, Selection, export_corpus};
use crate::scenario::EgoChoice;
use std::path::Path;

pub(in crate::cli) fn export(args: &ExportArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    let (only_verified, only_accepted) = (args.only_verified, args.only_accepted);
    let selection = Selection { only_verified, only_accepted, ..args.which.selection() };
    let ego = EgoChoice::from_name(&args.ego);
    let motion = match (args.free_ego, args.replay_ego) {
        (true, _) => Some(EgoMotion::Free),
        (false, true) => Some(EgoMotion::Replayed),
        (false, false) => None,
    };
    super::begins_anew(&args.out);
    let progress = TerminalProgress::new(output, *printer);
    let report = export_corpus(&args.corpus, args.format, &args.out, &selection, &ego, motion, &progress);
    let report = report.map_err(|error| hinted(error.into(), &args.corpus))?;
    for warning in report.warnings() {
        stderr_line(&printer.warning_line(&warning));
    }
    for (dataset, terms) in &report.sources {
        printer.message(format_args!("made from {dataset}: {terms}"));
    }
    let (n_scenarios, n_tracks) = (report.n_scenarios, report.n_tracks);
    printer.message(format_args!("{n_scenarios} scenarios with {n_tracks} tracks are in {}", args.out.display()));
    Ok(())
}

/// Adds advice if the folder is not a corpus.
fn hinted(failure: Failure, corpus: &Path) -> Failure {
    if corpus.join("manifest.json").is_file() {
        return failure;
    }
    failure.with_hint(format!(
        "{} is not a corpus; pass the folder `corpus` of a run, such as output/quickstart/main/corpus",
        corpus.display()
    ))
}
