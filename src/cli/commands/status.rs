//! `djinn status`: the progress of a run.

use crate::cli::args::StatusArgs;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::pipeline::status::status as describe;

pub(in crate::cli) fn status(args: &StatusArgs, printer: &Printer) -> Result<()> {
    let status = describe(&args.run)?;
    if args.json {
        let text = serde_json::to_string_pretty(&status).map_err(anyhow::Error::from)?;
        printer.data(&format!("{text}\n"))
    } else {
        printer.data(&status.text())
    }
}
