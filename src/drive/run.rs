//! Drives every selected scenario of a corpus, with the careful driver beside, and writes the results.

use super::kept::{Kept, parts};
use super::output::Output;
use super::pool::Pool;
use super::report::DriveReport;
use super::starts::Starts;
use super::{DriveConfig, Error, Origin, Result};
use crate::files::NewFolder;
use crate::generate::{Futures, held_out_in_order};
use crate::progress::Progress;
use crate::scenario::EgoChoice;
use crate::store::{CorpusReader, SceneStore};
use std::collections::BTreeSet;
use std::path::Path;

/// Drives scenarios of the corpus in `corpus`, in its order, and writes tables and report into the folder `out`, which
/// must be new or empty and appears when it is complete.
///
/// # Errors
/// Errors of the corpus, the folder and the model. A failure of a planner is an outcome.
pub fn drive_corpus(
    (corpus, out): (&Path, &Path),
    from: &Origin<'_>,
    ego: &EgoChoice,
    config: &DriveConfig,
    futures: &Futures<'_>,
    progress: &dyn Progress,
) -> Result<DriveReport> {
    config.check(futures)?;
    let reader = CorpusReader::open(corpus)?;
    let inputs = [("corpus", corpus)].into_iter().chain(config.scenes.as_deref().map(|scenes| ("scenes", scenes)));
    let scenes = config.scenes.as_deref().map(SceneStore::open).transpose()?;
    let loop_starts = match scenes.as_ref().filter(|_| config.split.is_some()) {
        Some(scenes) => loop_starts(&reader, scenes, futures.seed())?,
        None => Vec::new(),
    };
    let mut starts = Starts::new((corpus, &reader), scenes.as_ref(), (from, ego), config, futures.seed())?;
    let folder = NewFolder::begin(out, inputs)?;
    let of_scenes = scenes.as_ref().map_or("", SceneStore::fingerprint);
    let (kept, changed) = Kept::begin(out, &parts((&reader, of_scenes), from, ego, config, futures)?)?;
    if !changed.is_empty() {
        let changed = changed.join(", ");
        progress.warn(&format!("the drive begins anew: {changed} changed since it was interrupted"));
    }
    let mut output = Output::create((corpus, folder.path()), config, futures)?;
    let mut pool = Pool::new(from, config, futures)?;
    progress.start("drive", starts.n_most() as u64, "scenarios");
    loop {
        let situations = starts.next(pool.chunk())?;
        if situations.is_empty() {
            break;
        }
        let drives = pool.drive(&situations, &kept, progress)?;
        for (situation, drives) in situations.iter().zip(drives) {
            output.add(situation, drives)?;
        }
    }
    progress.finish();
    let (left_out, buckets) = starts.finish()?;
    let rates = config.rates.then(|| output.failure_rates(&buckets));
    let split = match config.split.as_ref().zip(scenes.as_ref()) {
        Some((split, scenes)) => {
            let by_buckets = rates.as_deref().unwrap_or_default();
            Some(pool.split(split, (scenes, &loop_starts), by_buckets, progress)?)
        }
        None => None,
    };
    let report = output.finish(left_out, (rates, split))?;
    folder.commit()?;
    if kept.n_found() > 0 {
        progress.warn(&format!(
            "{} scenarios were not driven again: an interrupted drive with the same settings had done so; if what the \
             planner reads has changed since, drive to another --out",
            kept.n_found()
        ));
    }
    kept.remove()?;
    Ok(report)
}

/// The scenes at the places of a corpus that no model learns from by default.
fn loop_starts(reader: &CorpusReader, scenes: &SceneStore, seed: u64) -> Result<Vec<usize>> {
    let places: Vec<String> = reader.manifest().scenarios_by_partition.iter().map(|part| part.place.clone()).collect();
    let order = held_out_in_order(scenes.index(), (&[], &places), &BTreeSet::new(), seed);
    if order.is_empty() {
        let why = "--scenes has no scene of the split val, or of no split, at the places of the corpus to begin a loop";
        return Err(Error::Config(why.to_owned()));
    }
    Ok(order.into_iter().map(|(position, _)| position).collect())
}
