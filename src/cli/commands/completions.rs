//! `djinn completions`: completions of the commands for a shell.

use crate::cli::args::Args;
use crate::cli::printer::Printer;
use crate::engine::Result;
use clap::CommandFactory;
use clap_complete::Shell;

pub(in crate::cli) fn completions(shell: Shell, printer: &Printer) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Args::command(), "djinn", &mut script);
    printer.data(&String::from_utf8_lossy(&script))
}
