//! `djinn report`: the page of one run, or a comparison of two.

use crate::cli::args::{Command, OutputArgs, ReportArgs};
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::pipeline::compare::write_comparison;
use std::path::Path;

/// The default name of the page of a comparison.
const COMPARISON_FILE: &str = "comparison.html";

pub(in crate::cli) fn report(
    args: &ReportArgs,
    command: &Command,
    output: &OutputArgs,
    printer: &Printer,
) -> Result<()> {
    let Some([a, b]) = args.compare.as_deref() else { return super::stage(command, output, printer) };
    let page = args.out.as_deref().unwrap_or(Path::new(COMPARISON_FILE));
    super::begins_anew(page);
    write_comparison(a, b, page)?;
    printer.message(format_args!("the comparison is in {}", page.display()));
    Ok(())
}
