//! Reads, parses and assembles in parallel, and passes on the scenes in the order of the recordings.

mod reading;
#[cfg(test)]
mod tests;

use self::reading::read_batches;
use super::assemble::assemble;
use super::batches::{Batch, BatchSender};
use super::config::IngestConfig;
use super::error::{BoxError, Error};
use super::lane_index::LaneIndex;
use super::map_catalog::MapCatalog;
use super::places::{Places, flaw_of, name_blank_place};
use super::raw::{Finding, RawScene, RawUnit, Reject, UnitSplit};
use super::report::IngestReport;
use super::source::RecordingSource;
use crate::progress::Progress;
use crate::scene::{LaneGraph, MapId, Scene};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, mpsc};

/// Scenes of consecutive units, in the order of the recordings.
#[derive(Debug, Default)]
pub struct IngestBatch {
    /// The scenes.
    pub scenes: Vec<Scene>,
    /// Maps that these scenes are the first to need, whole, in the recording's frame. After resuming, maps of earlier
    /// batches are repeated.
    pub maps: Vec<(MapId, LaneGraph)>,
    /// Units done after this batch: resuming after them continues with the next batch. `None` if the scenes of its last
    /// unit continue in the next batch.
    pub units_done: Option<u64>,
    /// The report on this batch alone.
    pub report: IngestReport,
}

/// What earlier batches hold.
#[derive(Debug, Clone, Default)]
pub struct Done {
    /// Their merged reports.
    pub report: IngestReport,
    /// [`Scene::identity`] of each of their scenes.
    pub scenes: BTreeSet<u128>,
}

/// Reads the recordings of `config.inputs` and passes their scenes to `sink`, batch after batch, in a thread of its
/// own.
///
/// Batches, scenes and reports depend on the inputs and the configuration only, not on threads. To resume, pass the
/// stored batches as `done`: their units are skipped without being parsed. Returns the report on everything, including
/// `done`. A scene that comes again is rejected; the first one stays.
///
/// # Errors
/// An input that cannot be read, a missing or damaged map, no scenes at all, or a failing sink. A damaged recording
/// among many is not an error: it is counted as a reject.
pub fn ingest(
    config: &IngestConfig,
    done: Option<Done>,
    progress: &dyn Progress,
    sink: &mut (dyn FnMut(IngestBatch) -> Result<(), BoxError> + Send),
) -> Result<IngestReport, Error> {
    config.validate()?;
    let source = super::source_of(config)?;
    let source = &*source;
    let Done { report: mut total, scenes } = done.unwrap_or_default();
    let mut seen = Seen { scenes, maps: BTreeSet::new() };
    let places = &Places::of(config);
    let maps = MapCatalog::read(config, source, places, progress)?;
    if config.limit.is_some_and(|limit| total.n_scenes >= limit) {
        maps.findings.into_iter().for_each(|finding| total.count_warning(finding));
        return Ok(total);
    }
    progress.start("ingest", config.limit.unwrap_or(0), "scenes");
    progress.advance(total.n_scenes);
    let parser = UnitParser { config, source, maps: &maps, places };
    // Units are read, parsed and stored at the same time; only parsing uses all threads.
    let files = std::thread::scope(|scope| {
        // Reading waits for the parser: recordings are large, and another batch would only take memory.
        let (unit_sender, units) = mpsc::sync_channel(0);
        let unit_sender = BatchSender::new(unit_sender, total.n_units);
        let reader = scope.spawn(|| read_batches(config, source, places, unit_sender));
        let (scene_sender, batches) = mpsc::sync_channel(1);
        let storer = scope.spawn(move || batches.into_iter().try_for_each(sink));
        let parsed = parser.parse_all(units, &mut total, &mut seen, progress, &scene_sender);
        drop(scene_sender);
        // The error of storing came first.
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
    total.warnings().chain(total.agents_left_out()).for_each(|warning| progress.warn(&warning));
    // These were announced when the maps were read. No batch has them: which one would depends on what was done before.
    maps.findings.into_iter().for_each(|finding| total.count_warning(finding));
    if total.n_scenes == 0 {
        let none = || Error::NoScenes { files: files.summary(config, source.pattern()), report: Box::new(total) };
        return Err(places.error().unwrap_or_else(none));
    }
    if config.limit.is_none_or(|limit| total.n_scenes < limit) {
        places.warning().into_iter().for_each(|warning| progress.warn(&warning));
    }
    Ok(total)
}

/// The most scenes to make at a time: a recording holds thousands.
const MAX_SCENES: usize = 64;

/// A scene to be made, or the outcome of a unit without any.
struct Pending<'a> {
    /// The size of the unit that begins with it.
    n_unit_bytes: Option<u64>,
    make: PendingOutcome<'a>,
}

type PendingOutcome<'a> = Box<dyn FnOnce() -> UnitOutcome + Send + 'a>;

enum UnitOutcome {
    Kept {
        scene: Box<Scene>,
        counts: IngestReport,
        own_map: Option<Arc<LaneGraph>>,
    },
    /// With the doubts that may explain it.
    Rejected(Reject, Vec<Finding>),
    /// Left out by the configuration, with the reason, and what was found about its recording.
    Unwanted(&'static str, Vec<Finding>),
    /// The map, and the file of the recording.
    MissingMap(MapId, String),
}

/// What came so far.
struct Seen {
    /// [`Scene::identity`] of each scene.
    scenes: BTreeSet<u128>,
    /// The maps handed out.
    maps: BTreeSet<MapId>,
}

struct UnitParser<'a> {
    config: &'a IngestConfig,
    source: &'a dyn RecordingSource,
    maps: &'a MapCatalog,
    places: &'a Places<'a>,
}

impl UnitParser<'_> {
    /// Parses units in parallel, before their scenes are made. Sends the scenes of all units, until the limit is
    /// reached or the receiver is gone, and counts them in `total`.
    fn parse_all(
        &self,
        units: mpsc::Receiver<Result<Batch, Error>>,
        total: &mut IngestReport,
        seen: &mut Seen,
        progress: &dyn Progress,
        sender: &mpsc::SyncSender<IngestBatch>,
    ) -> Result<(), Error> {
        let limit = self.config.limit;
        for units in units {
            let mut pending = self.parse_units(units?);
            while !pending.is_empty() {
                let room = limit.map(|limit| limit - total.n_scenes);
                let n_next = pending.len().min(MAX_SCENES);
                let batch = self.make_scenes(pending.drain(..n_next).collect(), room, seen)?;
                total.merge(&batch.report);
                progress.advance(batch.report.n_scenes);
                if total.n_rejects() > 0 {
                    progress.note(&format!("{} rejected", total.n_rejects()));
                }
                let is_enough = limit.is_some_and(|limit| total.n_scenes >= limit);
                let units_done = (is_enough || pending.is_empty()).then_some(total.n_units);
                if sender.send(IngestBatch { units_done, ..batch }).is_err() || is_enough {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    fn parse_units(&self, units: Batch) -> Vec<Pending<'_>> {
        let parsed: Vec<Vec<Pending<'_>>> = units.into_par_iter().map(|unit| self.parse_unit(unit)).collect();
        parsed.into_iter().flatten().collect()
    }

    fn parse_unit(&self, unit: Result<RawUnit, Reject>) -> Vec<Pending<'_>> {
        let n_bytes = unit.as_ref().map_or(0, RawUnit::n_bytes);
        let outcomes: Vec<PendingOutcome<'_>> = match unit {
            Err(reject) => vec![Box::new(|| UnitOutcome::Rejected(reject, Vec::new()))],
            Ok(unit) => match self.reason_unwanted(&unit) {
                Some(what) => vec![Box::new(move || UnitOutcome::Unwanted(what, Vec::new()))],
                None => {
                    let scenes = self.source.parse(unit).into_iter();
                    scenes.map(|scene| Box::new(|| self.finish_scene(scene())) as PendingOutcome<'_>).collect()
                }
            },
        };
        let begins = std::iter::once(Some(n_bytes)).chain(std::iter::repeat(None));
        outcomes.into_iter().zip(begins).map(|(make, n_unit_bytes)| Pending { n_unit_bytes, make }).collect()
    }

    /// The reason for which the configuration leaves a unit out, if it does.
    fn reason_unwanted(&self, unit: &RawUnit) -> Option<&'static str> {
        if let UnitSplit::All(split) = unit.split
            && !self.config.wants_split(split)
        {
            return Some(OTHER_SPLITS);
        }
        self.places.note(Some(&unit.place));
        (!unit.place.is_empty() && !self.config.wants_place(&unit.place)).then_some(OTHER_PLACES)
    }

    /// Makes scenes in parallel and collects the first `room` of them in order.
    fn make_scenes(&self, pending: Vec<Pending<'_>>, room: Option<u64>, seen: &mut Seen) -> Result<IngestBatch, Error> {
        let outcomes: Vec<(Option<u64>, UnitOutcome)> =
            pending.into_par_iter().map(|pending| (pending.n_unit_bytes, (pending.make)())).collect();
        let mut missing: BTreeMap<MapId, String> = BTreeMap::new();
        for (_, outcome) in &outcomes {
            if let UnitOutcome::MissingMap(id, file) = outcome {
                missing.entry(id.clone()).or_insert_with(|| file.clone());
            }
        }
        self.maps.require(missing.into_iter())?;

        let mut collected = IngestBatch::default();
        for (n_unit_bytes, outcome) in outcomes {
            let is_full = room.is_some_and(|room| collected.report.n_scenes >= room);
            if is_full && (n_unit_bytes.is_some() || matches!(outcome, UnitOutcome::Kept { .. })) {
                break;
            }
            if let Some(n_bytes) = n_unit_bytes {
                collected.report.n_units += 1;
                collected.report.n_bytes += n_bytes;
            }
            match outcome {
                UnitOutcome::Rejected(reject, findings) => {
                    collected.report.count_reject(&reject);
                    findings.into_iter().for_each(|finding| collected.report.count_warning(finding));
                }
                UnitOutcome::Unwanted(what, findings) => {
                    collected.report.count_dropped(what, 1);
                    findings.into_iter().for_each(|finding| collected.report.count_warning(finding));
                }
                UnitOutcome::MissingMap(..) => {}
                UnitOutcome::Kept { scene, .. } if !seen.scenes.insert(scene.identity()) => {
                    let detail = format!("{}: scene {} was read before; the first stays", scene.source.file, scene.id);
                    collected.report.count_reject(&Reject { reason: "scene_repeated", detail });
                }
                UnitOutcome::Kept { scene, counts, own_map } => {
                    collected.report.merge(&counts);
                    self.hand_out_map(&scene, own_map, &mut seen.maps, &mut collected.maps);
                    collected.scenes.push(*scene);
                }
            }
        }
        Ok(collected)
    }

    fn finish_scene(&self, scene: Result<RawScene, Reject>) -> UnitOutcome {
        let mut scene = match scene {
            Ok(scene) => scene,
            Err(reject) => return UnitOutcome::Rejected(reject, Vec::new()),
        };
        let findings = scene.findings.clone();
        if !self.config.wants_split(scene.source.split) {
            return UnitOutcome::Unwanted(OTHER_SPLITS, findings);
        }
        if let Some((reason, flaw)) = flaw_of(&scene.source.place, &scene.source.case_id) {
            let detail = format!("{}: {flaw}", scene.source.file);
            return UnitOutcome::Rejected(Reject { reason, detail }, findings);
        }
        name_blank_place(&mut scene);
        self.places.note(Some(&scene.source.place));
        if !self.config.wants_place(&scene.source.place) {
            return UnitOutcome::Unwanted(OTHER_PLACES, findings);
        }
        let own_map = if self.config.wants_maps() { scene.own_map.take() } else { None };
        let own_index = own_map.clone().map(LaneIndex::new);
        let map = own_index.as_ref().or_else(|| self.maps.get(&scene.map_id));
        if map.is_none() && self.config.wants_maps() {
            if self.source.has_own_maps() {
                let detail = format!("{}: has no lane; ingest.maps = \"none\" reads it without", scene.source.file);
                return UnitOutcome::Rejected(Reject { reason: "no_lanes", detail }, findings);
            }
            return UnitOutcome::MissingMap(scene.map_id, scene.source.file);
        }
        match assemble(scene, map, self.config) {
            Ok((scene, counts)) => UnitOutcome::Kept { scene: Box::new(scene), counts, own_map },
            Err(reject) => UnitOutcome::Rejected(reject, findings),
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
        if handed_out.contains(id) {
            return;
        }
        let graph = own_map.map(Arc::unwrap_or_clone).or_else(|| Some(self.maps.get(id)?.graph().clone()));
        if let Some(graph) = graph {
            handed_out.insert(id.clone());
            maps.push((id.clone(), graph));
        }
    }
}

const OTHER_SPLITS: &str = "units_of_other_splits";
const OTHER_PLACES: &str = "units_of_other_places";
