//! `djinn ingest --explain`: how recordings are understood.

use super::use_threads;
use crate::cli::args::{IngestArgs, OutputArgs};
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::engine::Result;
use crate::files::write_atomically;
use crate::ingest::{Explanation, IngestConfig, ingest};
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::stages::on_disk;
use crate::report::drawing_of_recording;
use std::io::Write;
use std::path::Path;

/// The most scenes to read.
const MAX_SCENES: u64 = 100;

pub(super) fn explain(
    config: &PipelineConfig,
    args: &IngestArgs,
    output: &OutputArgs,
    printer: &Printer,
) -> Result<()> {
    let Some(of_run) = &config.ingest else { return Ok(()) };
    use_threads(output, config.run.threads)?;
    let limit = Some(of_run.limit.map_or(MAX_SCENES, |limit| limit.min(MAX_SCENES)));
    let config = IngestConfig { limit, ..on_disk(of_run)? };
    let progress = TerminalProgress::new(output, *printer);
    let mut scenes = Vec::new();
    let mut sink = |batch: crate::ingest::IngestBatch| {
        scenes.extend(batch.scenes);
        Ok(())
    };
    let report = ingest(&config, None, &progress, &mut sink)?;
    printer.data(&Explanation::of(&scenes, &report).to_string())?;
    let picture = args.explain.as_deref().filter(|path| *path != Path::new("-"));
    if let (Some(path), Some(scene)) = (picture, scenes.first()) {
        write_atomically(path, |file| file.write_all(drawing_of_recording(scene).as_bytes()))?;
        printer.message(format_args!("the first scene is drawn in {}", path.display()));
    }
    Ok(())
}
