//! `djinn init`: a folder to start from.

use crate::cli::args::InitArgs;
use crate::cli::bundled::folder_of;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::files::{NewFolder, check_free, for_shell, write_atomically};
use std::io::Write;
use std::path::{Component, Path};

pub(in crate::cli) fn init(args: &InitArgs, printer: &Printer) -> Result<()> {
    write(&args.dir, &args.pipeline, printer)?;
    let pipeline = &args.pipeline;
    let there = match is_here(&args.dir) {
        true => String::new(),
        false => format!("cd {} && ", for_shell(&args.dir.to_string_lossy())),
    };
    printer.message(format_args!("{pipeline}.toml says what it does; next: {there}djinn run {pipeline}.toml"));
    Ok(())
}

/// Whether a path leads to the current folder, which keeps its place.
fn is_here(dir: &Path) -> bool {
    dir.components().all(|part| part == Component::CurDir)
}

/// Writes a bundled pipeline and what it reads into a new folder.
pub(super) fn write(dir: &Path, pipeline: &str, printer: &Printer) -> Result<()> {
    super::begins_anew(dir);
    let files = folder_of(pipeline);
    let write_into = |folder: &Path| -> Result<()> {
        for (name, content) in &files {
            let path = folder.join(name);
            path.parent().map_or(Ok(()), fs_err::create_dir_all)?;
            write_atomically(&path, |file| file.write_all(content))?;
        }
        Ok(())
    };
    if is_here(dir) {
        check_free(dir)?;
        write_into(dir)?;
    } else {
        let folder = NewFolder::begin(dir, [])?;
        write_into(folder.path())?;
        folder.commit()?;
    }
    for (name, _) in &files {
        printer.message(format_args!("wrote {}", dir.join(name).display()));
    }
    Ok(())
}
