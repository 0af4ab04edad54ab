//! `djinn regenerate`: generates one scenario again and compares it with its row.

use super::{begins_anew, use_threads};
use crate::cli::args::{OutputArgs, RegenerateArgs};
use crate::cli::printer::Printer;
use crate::engine::{ComputeChoice, Failure, Result};
use crate::files::check_overlap;
use crate::pipeline::layout::Layout;
use crate::pipeline::regenerate::{Regenerated, regenerate as generate_again};
use crate::store::write_samples;
use std::path::Path;

pub(in crate::cli) fn regenerate(args: &RegenerateArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    use_threads(output, 0)?;
    let beside_corpus = args.corpus.as_deref().and_then(Path::parent);
    let corpus = args.corpus.as_deref();
    let mut layout = Layout::below(args.from.as_deref().or(beside_corpus).unwrap_or(Path::new(".")));
    args.scenes.scenes.iter().for_each(|path| layout.scenes.clone_from(path));
    args.models.replace_in(&mut layout);
    if let Some(path) = &args.out {
        check_new(path, &layout, corpus)?;
        begins_anew(path);
    }
    let compute = ComputeChoice { device: args.device, precision: args.precision };
    let Regenerated { stored, again, differences, n_columns } =
        generate_again(&args.scenario, &layout, corpus, &compute.open()?)?;
    if let Some(path) = &args.out {
        write_samples(path, std::slice::from_ref(&again))?;
    }
    let provenance = &stored.scenario.provenance;
    printer.message(format_args!(
        "{}: sweep {}, scene {}, {}, sample {}, shard {}",
        stored.scenario.id,
        stored.sweep,
        provenance.scene_id,
        provenance.guidance.level,
        provenance.sample_idx,
        stored.shard
    ));
    if differences.is_empty() {
        return printer.data(&format!("identical: all {n_columns} columns are the same, bit by bit\n"));
    }
    let lines = differences.iter().map(|difference| {
        let [stored, again] = &difference.values;
        format!("{}: stored {stored}, again {again}\n", difference.column)
    });
    printer.data(&lines.collect::<String>())?;
    let message = format_args!("scenario {} differs in {} of {n_columns} columns", args.scenario, differences.len());
    Err(Failure::input_message(message)
        .with_hint("check whether another version of djinn or another kind of processor generated it"))
}

/// Checks that the file is new and none of the inputs.
fn check_new(path: &Path, layout: &Layout, corpus: Option<&Path>) -> Result<()> {
    let inputs = [
        ("scenes", &layout.scenes),
        ("denoiser", &layout.denoiser),
        ("classifier", &layout.classifier),
        ("distilled", &layout.distilled),
        ("baseline", &layout.baseline),
        ("samples", &layout.samples),
    ];
    let inputs = inputs.into_iter().map(|(name, path)| (name, path.as_path()));
    check_overlap(path, inputs.chain(corpus.map(|corpus| ("corpus", corpus))))?;
    if path.symlink_metadata().is_ok() {
        let message = format!("cannot write {}: it already exists; nothing was changed", path.display());
        return Err(Failure::input_message(message).with_hint("name a new file"));
    }
    Ok(())
}
