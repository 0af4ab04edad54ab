//! `djinn inspect`: what a file or folder of ours holds.

use crate::cli::args::InspectArgs;
use crate::cli::printer::Printer;
use crate::pipeline::{Failure, Result};

pub(in crate::cli) fn inspect(args: &InspectArgs, printer: &Printer) -> Result<()> {
    let _ = printer;
    Err(Failure::input_message(format_args!("{} is nothing that djinn writes", args.path.display())))
}
