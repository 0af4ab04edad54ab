//! The command line: which command was given, and what is printed where?
//!
//! Data goes to stdout, everything else to stderr. Only this module prints, and only it knows clap and indicatif.

mod args;
mod bundled;
mod commands;
mod exit;
mod help;
mod panics;
mod printer;
mod progress;
mod signals;

use crate::cloud::use_cache_dir;
use args::{Args, Command};
use clap::Parser;
use clap::error::ErrorKind;
use printer::Printer;
use std::process::ExitCode;

/// Runs the program on the process's arguments.
pub fn main() -> ExitCode {
    let args = match Args::try_parse() {
        Ok(args) => args,
        Err(error) if error.kind() == ErrorKind::DisplayVersion => {
            printer::version_line();
            return exit::DONE;
        }
        Err(error) => return exit::of_usage(&error),
    };
    let printer = Printer::new(&args.output);
    args.output.cache_dir.iter().for_each(|dir| use_cache_dir(dir));
    signals::watch();
    let outcome = panics::told(|| match &args.command {
        Command::Run(run) => commands::run(run, &args.output, &printer),
        Command::Submit(submit) => commands::submit(submit, &printer),
        Command::Status(status) => commands::status(status, &printer),
        Command::Corpus(corpus) => commands::corpus(corpus, &args.output, &printer),
        Command::Drive(drive) => commands::drive(drive, &args.output, &printer),
        Command::Score(score) => commands::score(score, &args.output, &printer),
        Command::Export(export) => commands::export(export, &args.output, &printer),
        Command::Regenerate(regenerate) => commands::regenerate(regenerate, &args.output, &printer),
        Command::Inspect(inspect) => commands::inspect(inspect, &printer),
        Command::Init(init) => commands::init(init, &printer),
        Command::List(list) => commands::list(list.what, &printer),
        Command::Completions(completions) => commands::completions(completions.shell, &printer),
        Command::Man(man) => commands::man(man, &printer),
        stage => commands::stage(stage, &args.output, &printer),
    });
    match outcome {
        Ok(()) => exit::DONE,
        Err(failure) => {
            printer.failure(&failure, signals::advice().as_deref());
            exit::of_failure(&failure)
        }
    }
}
