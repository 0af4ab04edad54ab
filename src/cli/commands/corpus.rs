//! `djinn corpus`: the tools for finished corpora.

use crate::cli::args::{CorpusCommand, CorpusFilterArgs, OutputArgs};
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::corpus::{
    Condition, CopyOutcome, FilterOptions, Finding, Severity, Top, ValidationReport, filter, merge, validate,
};
use crate::engine::{Failure, Result};
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;

pub(in crate::cli) fn corpus(command: &CorpusCommand, output: &OutputArgs, printer: &Printer) -> Result<()> {
    super::use_threads(output, 0)?;
    let progress = TerminalProgress::new(output, *printer);
    match command {
        CorpusCommand::Validate(args) => {
            let report = validate(&args.corpus, &progress)?;
            print(printer, args.json, &report, validation_text)?;
            match report.n_damages {
                0 => Ok(()),
                n => {
                    let message = format_args!("{} is damaged: {n} findings", args.corpus.display());
                    Err(Failure::input_message(message)
                        .with_hint("copy it again, or remove it and run the command that wrote it"))
                }
            }
        }
        CorpusCommand::Merge(args) => {
            super::begins_anew(&args.out);
            let outcome = merge(&args.corpora, &args.out, &progress)?;
            tell(printer, &outcome, &args.out);
            Ok(())
        }
        CorpusCommand::Filter(args) => {
            let options = filter_options(args)?;
            super::begins_anew(&args.out);
            let outcome = filter(&args.corpus, &options, &args.out, &progress)?;
            tell(printer, &outcome, &args.out);
            Ok(())
        }
    }
}

fn filter_options(args: &CorpusFilterArgs) -> Result<FilterOptions> {
    let conditions = args.conditions.iter().map(|text| text.parse::<Condition>());
    let ids = args.ids.as_ref().map(|path| -> Result<Vec<String>> {
        let text = match path.as_os_str() == "-" {
            true => std::io::read_to_string(std::io::stdin()),
            false => fs_err::read_to_string(path),
        };
        let text = text.map_err(Failure::input)?;
        Ok(text.lines().map(str::trim).filter(|id| !id.is_empty()).map(str::to_owned).collect())
    });
    let top = args.top.zip(args.by.clone()).map(|(n, column)| Top { n, column, least: args.least });
    Ok(FilterOptions {
        conditions: conditions.collect::<std::result::Result<Vec<_>, _>>()?,
        ids: ids.transpose()?,
        top,
    })
}

/// Prints data as JSON or as text.
fn print<T: Serialize>(printer: &Printer, json: bool, value: &T, text: fn(&T) -> String) -> Result<()> {
    if json {
        let json = serde_json::to_string_pretty(value).map_err(anyhow::Error::from)?;
        printer.data(&format!("{json}\n"))
    } else {
        printer.data(&text(value))
    }
}

/// Prints a summary of the written corpus.
fn tell(printer: &Printer, outcome: &CopyOutcome, out: &Path) {
    let CopyOutcome { manifest, n_duplicates, n_differing_recordings, n_aggregates_left_out } = outcome;
    printer.message(format_args!(
        "{} scenarios ({} verified) of {} recorded scenes are in {}",
        manifest.n_scenarios,
        manifest.n_verified,
        manifest.n_recordings,
        out.display()
    ));
    if *n_duplicates > 0 {
        printer.message(format_args!("{n_duplicates} scenarios were in several corpora and were written once"));
    }
    if *n_differing_recordings > 0 {
        printer.message(format_args!(
            "{n_differing_recordings} recorded scenes differ between the corpora, for example in which agents were \
             kept; the first was used"
        ));
    }
    if *n_aggregates_left_out > 0 {
        printer.message(format_args!(
            "{n_aggregates_left_out} aggregated metric values were left out, because they cover whole runs; metrics of \
             scenarios were kept"
        ));
    }
    if manifest.n_scenarios == 0 {
        printer.message("the new corpus is empty: no scenario met the conditions");
    }
}

fn validation_text(report: &ValidationReport) -> String {
    let ValidationReport { n_files, n_scenarios, n_states, n_damages, n_remarks, by_check, findings } = report;
    let mut text = String::new();
    for Finding { severity, check, file, row, detail } in findings {
        let severity = if *severity == Severity::Damage { "damage" } else { "remark" };
        let row = row.map_or(String::new(), |row| format!(", row {row}"));
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{severity} ({check}): {file}{row}: {detail}");
    }
    for (check, n) in by_check {
        let n_shown = findings.iter().filter(|finding| finding.check == *check).count() as u64;
        if *n > n_shown {
            let _ = writeln!(text, "… and {} more of {check}", n - n_shown);
        }
    }
    let verdict = if *n_damages == 0 { "whole" } else { "damaged" };
    let _ = writeln!(
        text,
        "{verdict}: {n_damages} errors, {n_remarks} remarks in {n_files} files, {n_scenarios} scenarios, {n_states} \
         states"
    );
    text
}
