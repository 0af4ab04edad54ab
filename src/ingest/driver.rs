//! Reads, parses and assembles in parallel, and hands the scenes on in the order of the recordings.

use super::archive::visit_entries;
use super::assemble::assemble;
use super::batches::{Batch, BatchSender};
use super::config::IngestConfig;
use super::error::{BoxError, Error};
use super::lane_index::LaneIndex;
use super::map_catalog::MapCatalog;
use super::raw::{RawScene, RawUnit, Reject, UnitSplit};
use super::report::IngestReport;
use super::source::RecordingSource;
use crate::progress::Progress;
use crate::scene::{LaneGraph, MapId, Scene};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::{Arc, mpsc};

/// Scenes of consecutive units, in the order of the recordings.
#[derive(Debug, Default)]
pub struct IngestBatch {
    /// The scenes.
    pub scenes: Vec<Scene>,
    /// Maps that these scenes are the first to need, whole, in the recording's frame. After resuming, maps that were
    /// handed out before come again.
    pub maps: Vec<(MapId, LaneGraph)>,
    /// Units done with this batch and all before it: resuming after them continues with the next batch.
    pub units_done: u64,
    /// What this batch alone read, kept and left out.
    pub report: IngestReport,
}

/// Reads the recordings of `config.inputs` and hands their scenes to `sink`, batch after batch, in a thread of its own.
///
/// Batches, scenes and reports depend on the inputs and the configuration only, not on threads. To resume, pass the merged
/// reports of the batches that were stored as `done`: their units are read over without being parsed. Returns the report
/// of everything, `done` included.
///
/// # Errors
/// An input that cannot be read, a missing or damaged map, no scenes at all, or a failing sink. A damaged recording among
/// many is no error: it is counted as a reject.
pub fn ingest(
    config: &IngestConfig,
    done: Option<&IngestReport>,
    progress: &dyn Progress,
    sink: &mut (dyn FnMut(IngestBatch) -> Result<(), BoxError> + Send),
) -> Result<IngestReport, Error> {
    config.validate()?;
    let source = super::source_of(config)?;
    let source = &*source;
    let mut total = done.cloned().unwrap_or_default();
    if config.limit.is_some_and(|limit| total.n_scenes >= limit) {
        return Ok(total);
    }
    let maps = MapCatalog::read(config, source, progress)?;
    progress.start("ingest", config.limit.unwrap_or(0), "scenes");
    progress.advance(total.n_scenes);
    let parser = UnitParser { config, source, maps: &maps };
    // Units are read, parsed and stored at the same time; parsing is what takes all threads.
    let seen = std::thread::scope(|scope| {
        let (unit_sender, units) = mpsc::sync_channel(1);
        let unit_sender = BatchSender::new(unit_sender, total.n_units);
        let reader = scope.spawn(move || read_batches(config, source, unit_sender));
        let (scene_sender, batches) = mpsc::sync_channel(1);
        let storer = scope.spawn(move || batches.into_iter().try_for_each(sink));
        let mut handed_out = BTreeSet::new();
        let parse_all = || -> Result<(), Error> {
            for batch in units {
                let room = config.limit.map(|limit| limit - total.n_scenes);
                let batch = parser.parse_batch(batch?, room, &mut handed_out)?;
                total.merge(&batch.report);
                progress.advance(batch.report.n_scenes);
                if total.n_rejects() > 0 {
                    progress.note(&format!("{} rejected", total.n_rejects()));
                }
                let sent = scene_sender.send(IngestBatch { units_done: total.n_units, ..batch });
                if sent.is_err() || config.limit.is_some_and(|limit| total.n_scenes >= limit) {
                    break;
                }
            }
            Ok(())
        };
        let parsed = parse_all();
        drop(scene_sender);
        // What could not be stored came first.
        storer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)).map_err(Error::Sink)?;
        parsed?;
        // The receiver is gone by now, which ends the reader.
        Ok::<_, Error>(reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })?;
    progress.finish();
    for (reason, rejects) in &total.rejects {
        let first = rejects.examples.first().map_or("", String::as_str);
        progress.warn(&format!("{} rejected as {reason}, the first: {first}", rejects.count));
    }
    if total.n_scenes == 0 {
        return Err(Error::NoScenes { files: seen.summary(config), report: Box::new(total) });
    }
    Ok(total)
}

/// The files that the reader came across.
#[derive(Default)]
struct SeenFiles {
    n_recordings: u64,
    n_others: u64,
    example_of_others: Option<String>,
}

impl SeenFiles {
    fn summary(&self, config: &IngestConfig) -> String {
        let inputs: Vec<String> = config.inputs.iter().map(|input| input.display().to_string()).collect();
        let example = self.example_of_others.as_ref().map_or(String::new(), |path| format!(", such as {path}"));
        format!(
            "{} has {} files named like {} recordings of the chosen splits and {} other files{example}",
            inputs.join(", "),
            self.n_recordings,
            config.dataset.name(),
            self.n_others
        )
    }
}

/// The reading thread: cuts all recordings into units until the receiver is gone.
fn read_batches(config: &IngestConfig, source: &dyn RecordingSource, mut sender: BatchSender) -> SeenFiles {
    let seen = std::cell::RefCell::new(SeenFiles::default());
    let is_wanted = |path: &str| {
        let is_recording = source.is_recording(path);
        let seen = &mut *seen.borrow_mut();
        if is_recording {
            seen.n_recordings += 1;
        } else {
            seen.n_others += 1;
            seen.example_of_others.get_or_insert_with(|| path.to_owned());
        }
        is_recording
    };
    let mut units = source.unit_reader();
    let mut emit = |unit: Result<RawUnit, Reject>| {
        let n_bytes = unit.as_ref().map_or(0, |unit| source.n_bytes_parsed(unit));
        sender.push(unit, n_bytes)
    };
    let mut read_all = || -> Result<(), Error> {
        loop {
            seen.take();
            let mut is_stopped = false;
            visit_entries(&config.inputs, &is_wanted, &mut |entry, reader| {
                let flow = units.read(entry, reader, &mut emit)?;
                is_stopped = flow.is_break();
                Ok(flow)
            })?;
            if is_stopped || !units.next_pass() {
                return units.finish(&mut emit).map(drop);
            }
        }
    };
    let result = read_all();
    sender.finish(result);
    seen.into_inner()
}

/// What became of one scene or unit.
enum UnitOutcome {
    Kept {
        scene: Box<Scene>,
        counts: IngestReport,
        own_map: Option<Arc<LaneGraph>>,
    },
    Rejected(Reject),
    /// Left out by the configuration; says as what.
    Unwanted(&'static str),
    MissingMap(MapId),
}

struct UnitParser<'a> {
    config: &'a IngestConfig,
    source: &'a dyn RecordingSource,
    maps: &'a MapCatalog,
}

impl UnitParser<'_> {
    /// Parses the units of a batch in parallel and collects the first `room` scenes in order.
    fn parse_batch(
        &self,
        batch: Batch,
        room: Option<u64>,
        handed_out: &mut BTreeSet<MapId>,
    ) -> Result<IngestBatch, Error> {
        let outcomes: Vec<(u64, Vec<UnitOutcome>)> = batch.into_par_iter().map(|unit| self.parse_unit(unit)).collect();
        let missing: BTreeSet<MapId> = outcomes
            .iter()
            .flat_map(|(_, outcomes)| outcomes)
            .filter_map(|outcome| if let UnitOutcome::MissingMap(id) = outcome { Some(id.clone()) } else { None })
            .collect();
        self.maps.require(missing.into_iter())?;

        let mut collected = IngestBatch::default();
        for (n_bytes, outcomes) in outcomes {
            if room.is_some_and(|room| collected.report.n_scenes >= room) {
                break;
            }
            collected.report.n_units += 1;
            collected.report.n_bytes += n_bytes;
            for outcome in outcomes {
                match outcome {
                    UnitOutcome::Rejected(reject) => collected.report.count_reject(&reject),
                    UnitOutcome::Unwanted(what) => collected.report.count_dropped(what, 1),
                    UnitOutcome::MissingMap(_) => {}
                    UnitOutcome::Kept { .. } if room.is_some_and(|room| collected.report.n_scenes >= room) => break,
                    UnitOutcome::Kept { scene, counts, own_map } => {
                        collected.report.merge(&counts);
                        self.hand_out_map(&scene, own_map, handed_out, &mut collected.maps);
                        collected.scenes.push(*scene);
                    }
                }
            }
        }
        Ok(collected)
    }

    fn parse_unit(&self, unit: Result<RawUnit, Reject>) -> (u64, Vec<UnitOutcome>) {
        let unit = match unit {
            Ok(unit) => unit,
            Err(reject) => return (0, vec![UnitOutcome::Rejected(reject)]),
        };
        if let UnitSplit::All(split) = unit.split
            && !self.config.wants_split(split)
        {
            return (unit.n_bytes(), vec![UnitOutcome::Unwanted(OTHER_SPLITS)]);
        }
        if !unit.place.is_empty() && !self.config.wants_place(&unit.place) {
            return (unit.n_bytes(), vec![UnitOutcome::Unwanted(OTHER_PLACES)]);
        }
        let scenes = self.source.parse(&unit);
        (unit.n_bytes(), scenes.into_par_iter().map(|scene| self.finish_scene(scene)).collect())
    }

    fn finish_scene(&self, scene: Result<RawScene, Reject>) -> UnitOutcome {
        let mut scene = match scene {
            Ok(scene) => scene,
            Err(reject) => return UnitOutcome::Rejected(reject),
        };
        if !self.config.wants_split(scene.source.split) {
            return UnitOutcome::Unwanted(OTHER_SPLITS);
        }
        if !self.config.wants_place(&scene.source.place) {
            return UnitOutcome::Unwanted(OTHER_PLACES);
        }
        let own_map = if self.config.wants_maps() { scene.own_map.take() } else { None };
        let own_index = own_map.clone().map(LaneIndex::new);
        let map = own_index.as_ref().or_else(|| self.maps.get(&scene.map_id));
        if map.is_none() && self.config.wants_maps() {
            return UnitOutcome::MissingMap(scene.map_id);
        }
        match assemble(scene, map, self.config) {
            Ok((scene, counts)) => UnitOutcome::Kept { scene: Box::new(scene), counts, own_map },
            Err(reject) => UnitOutcome::Rejected(reject),
        }
    }

    fn hand_out_map(
        &self,
        scene: &Scene,
        own_map: Option<Arc<LaneGraph>>,
        handed_out: &mut BTreeSet<MapId>,
        maps: &mut Vec<(MapId, LaneGraph)>,
    ) {
        let Some(id) = &scene.map_id else { return };
        if let Some(graph) = own_map {
            maps.push((id.clone(), Arc::unwrap_or_clone(graph)));
        } else if let Some(index) = self.maps.get(id)
            && handed_out.insert(id.clone())
        {
            maps.push((id.clone(), index.graph().clone()));
        }
    }
}

const OTHER_SPLITS: &str = "units_of_other_splits";
const OTHER_PLACES: &str = "units_of_other_places";

#[cfg(test)]
mod tests;
