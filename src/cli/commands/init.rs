//! `djinn init`: a folder to start from.

use crate::cli::args::InitArgs;
use crate::cli::bundled::folder_of;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::files::{NewFolder, write_atomically};
use std::io::Write;
use std::path::Path;

pub(in crate::cli) fn init(args: &InitArgs, printer: &Printer) -> Result<()> {
    write(&args.dir, &args.pipeline, printer)?;
    let pipeline = &args.pipeline;
    printer.message(format_args!(
        "{pipeline}.toml says what it does; next: cd {} && djinn run {pipeline}.toml",
        args.dir.display()
    ));
    Ok(())
}

/// Writes a bundled pipeline and what it reads into a new folder.
pub(super) fn write(dir: &Path, pipeline: &str, printer: &Printer) -> Result<()> {
    super::begins_anew(dir);
    let folder = NewFolder::begin(dir, [])?;
    let files = folder_of(pipeline);
    for (name, content) in &files {
        let path = folder.path().join(name);
        path.parent().map_or(Ok(()), fs_err::create_dir_all)?;
        write_atomically(&path, |file| file.write_all(content))?;
    }
    folder.commit()?;
    for (name, _) in &files {
        printer.message(format_args!("wrote {}", dir.join(name).display()));
    }
    Ok(())
}
