//! `djinn init`: a folder to start from.

use crate::cli::args::InitArgs;
use crate::cli::bundled::folder_of;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::files::{NewFolder, write_atomically};
use std::io::Write;

pub(in crate::cli) fn init(args: &InitArgs, printer: &Printer) -> Result<()> {
    super::begins_anew(&args.dir);
    let folder = NewFolder::begin(&args.dir, [])?;
    let files = folder_of(&args.pipeline);
    for (name, content) in &files {
        let path = folder.path().join(name);
        path.parent().map_or(Ok(()), fs_err::create_dir_all)?;
        write_atomically(&path, |file| file.write_all(content))?;
    }
    folder.commit()?;
    for (name, _) in &files {
        printer.message(format_args!("wrote {}", args.dir.join(name).display()));
    }
    let pipeline = &args.pipeline;
    printer.message(format_args!(
        "{pipeline}.toml says what it does; next: cd {} && djinn run {pipeline}.toml",
        args.dir.display()
    ));
    Ok(())
}
