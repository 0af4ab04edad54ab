//! `djinn inspect`: the content of a file or folder that djinn wrote.

use crate::cli::args::InspectArgs;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::pipeline::inspect::inspect as describe;

pub(in crate::cli) fn inspect(args: &InspectArgs, printer: &Printer) -> Result<()> {
    let description = describe(&args.path)?;
    if args.json {
        let text = serde_json::to_string_pretty(&description.json()).map_err(anyhow::Error::from)?;
        printer.data(&format!("{text}\n"))
    } else {
        printer.data(&description.text())
    }
}
