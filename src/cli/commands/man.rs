//! `djinn man`: the help texts as manual pages.

use crate::cli::args::{Args, ManArgs};
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::files::{NewFolder, write_atomically};
use clap::CommandFactory;
use clap_mangen::Man;

pub(in crate::cli) fn man(args: &ManArgs, printer: &Printer) -> Result<()> {
    super::begins_anew(&args.dir);
    let folder = NewFolder::begin(&args.dir, [])?;
    let mut program = Args::command().disable_help_subcommand(true);
    program.build();
    let mut commands = vec![program];
    let mut n_pages = 0;
    while let Some(command) = commands.pop() {
        commands.extend(command.get_subcommands().filter(|command| !command.is_hide_set()).cloned());
        let page = Man::new(command);
        write_atomically(&folder.path().join(page.get_filename()), |mut file| page.render(&mut file))?;
        n_pages += 1;
    }
    folder.commit()?;
    printer.message(format_args!("wrote {n_pages} manual pages to {}", args.dir.display()));
    Ok(())
}
