//! Writes a new corpus from scenarios of others, with everything that belongs to them.
//!
//! A scenario is copied with its states, its metric values, its recorded scene and its map; recordings and maps that
//! several scenarios share are copied once. Aggregated metric values are over the samples of a run and hold for no
//! other choice: they are left out.

use super::rows::{RowBytes, add_rows, texts};
use super::{Error, Result};
use crate::files::NewFolder;
use crate::progress::Progress;
use crate::scene::{LaneGraph, MapId};
use crate::store::{
    CorpusChunk, CorpusManifest, CorpusNotes, CorpusScan, CorpusSink, CorpusTable, Fingerprint, MapSource, Partition,
    fingerprint, partitioned, taken, united, widened,
};
use arrow::array::{Array, BooleanArray, RecordBatch};
use arrow::compute::filter_record_batch;
use arrow::datatypes::SchemaRef;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Decides which scenarios to copy.
pub(super) trait CopySelection {
    /// Whether a file can hold any of them; a corpus with one file per table has no partitions.
    fn wants_part(&self, _partition: &Partition) -> bool {
        true
    }

    /// Which scenarios of a chunk of corpus `input` to copy.
    fn keep(&mut self, input: usize, chunk: &CorpusChunk) -> Result<Vec<bool>>;
}

/// The report of a tool that writes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CopyOutcome {
    /// The manifest of the new corpus.
    pub manifest: CorpusManifest,
    /// Scenarios that are in several corpora, and were copied once.
    pub n_duplicates: u64,
    /// Recorded scenes that differ between corpora; the first one was copied.
    pub n_differing_recordings: u64,
    /// Aggregated metric values that were left out.
    pub n_aggregates_left_out: u64,
}

/// Copies the scenarios of `inputs` that `selection` keeps into a new corpus at `out`, one corpus after the other, each
/// in its order.
pub(super) fn copy(
    inputs: &[CorpusScan],
    out: &Path,
    history: &str,
    selection: &mut dyn CopySelection,
    progress: &dyn Progress,
) -> Result<CopyOutcome> {
    let schemas = inputs.iter().map(CorpusScan::scenario_schema).collect::<Result<Vec<_>, _>>()?;
    let folder = NewFolder::begin(out, inputs.iter().map(|scan| ("corpus", scan.dir())))?;
    let mut copier = Copier {
        sink: CorpusSink::create(folder.path())?,
        schema: united(&schemas),
        maps: BTreeMap::new(),
        recordings: BTreeMap::new(),
        compares_recordings: inputs.len() > 1,
        n_differing_recordings: 0,
        n_aggregates_left_out: 0,
    };
    // Queries over a corpus without scenarios find the columns, too.
    copier.sink.write_scenarios(&RecordBatch::new_empty(Arc::clone(&copier.schema)))?;
    progress.start("copy", inputs.iter().map(|scan| scan.manifest().n_scenarios).sum(), "scenarios");
    let mut needed = Needed::default();
    for (i, scan) in inputs.iter().enumerate() {
        let kept = copier.scenarios(i, scan, selection, &mut needed, progress)?;
        copier.metrics(scan, &kept)?;
    }
    // Rows that a scenario needs may be in another corpus than the scenario.
    for scan in inputs {
        copier.maps(scan, &needed.maps)?;
        copier.recordings(scan, &needed.scenes)?;
    }
    progress.finish();
    let manifests: Vec<&CorpusManifest> = inputs.iter().map(CorpusScan::manifest).collect();
    let about = notes(&manifests, &needed.datasets);
    let mut steps: Vec<String> = Vec::new();
    for step in manifests.iter().flat_map(|manifest| &manifest.history).map(String::as_str).chain([history]) {
        if !steps.iter().any(|known| known == step) {
            steps.push(step.to_owned());
        }
    }
    let outcome = CopyOutcome {
        manifest: copier.sink.finish(&about, &steps)?,
        n_duplicates: 0,
        n_differing_recordings: copier.n_differing_recordings,
        n_aggregates_left_out: copier.n_aggregates_left_out,
    };
    folder.commit()?;
    Ok(outcome)
}

struct Copier {
    sink: CorpusSink,
    /// The columns of scenarios in the new corpus.
    schema: SchemaRef,
    maps: BTreeMap<String, LaneGraph>,
    /// The content of every copied recorded scene, if several corpora may hold one.
    recordings: BTreeMap<Fingerprint, Fingerprint>,
    compares_recordings: bool,
    n_differing_recordings: u64,
    n_aggregates_left_out: u64,
}

/// Keys of the rows that belong to the copied scenarios.
#[derive(Default)]
struct Needed {
    scenes: BTreeSet<Fingerprint>,
    maps: BTreeSet<String>,
    datasets: BTreeSet<String>,
}

impl Needed {
    /// Remembers the rows that the kept scenarios of a chunk need, and the scenarios themselves.
    fn note(&mut self, chunk: &CorpusChunk, keep: &[bool], kept: &mut BTreeSet<Fingerprint>) -> Result<()> {
        let column = |name: &str| texts(&chunk.scenarios, name, &chunk.path);
        let (ids, scenes, maps, datasets) =
            (column("scenario_id")?, column("scene_id")?, column("map_id")?, column("dataset")?);
        for row in (0..chunk.len()).filter(|row| keep[*row]) {
            kept.insert(fingerprint(ids.value(row).as_bytes()));
            self.scenes.insert(fingerprint(scenes.value(row).as_bytes()));
            if !maps.is_null(row) && !self.maps.contains(maps.value(row)) {
                self.maps.insert(maps.value(row).to_owned());
            }
            if !self.datasets.contains(datasets.value(row)) {
                self.datasets.insert(datasets.value(row).to_owned());
            }
        }
        Ok(())
    }
}

impl Copier {
    /// Copies the scenarios of one corpus with their states, and returns which were copied.
    fn scenarios(
        &mut self,
        input: usize,
        scan: &CorpusScan,
        selection: &mut dyn CopySelection,
        needed: &mut Needed,
        progress: &dyn Progress,
    ) -> Result<BTreeSet<Fingerprint>> {
        let mut kept = BTreeSet::new();
        for part in 0..scan.n_parts() {
            let (file, _) = scan.part(part)?;
            if !selection.wants_part(&file.partition) {
                progress.advance(file.n_rows);
                continue;
            }
            for chunk in scan.chunks(part, true)? {
                let mut chunk = chunk?;
                chunk.scenarios = widened(&chunk.scenarios, &self.schema, &chunk.path)?;
                let keep = selection.keep(input, &chunk)?;
                needed.note(&chunk, &keep, &mut kept)?;
                self.write(&chunk, &keep)?;
                progress.advance(chunk.len() as u64);
            }
        }
        Ok(kept)
    }

    fn write(&mut self, chunk: &CorpusChunk, keep: &[bool]) -> Result<()> {
        if !keep.contains(&true) {
            return Ok(());
        }
        let kept_rows: Vec<u32> = (0..chunk.len()).filter(|row| keep[*row]).map(|row| row as u32).collect();
        self.sink.write_scenarios(&taken(&chunk.scenarios, &kept_rows)?)?;
        for (partition, rows) in partitioned(&chunk.scenarios, &chunk.path)? {
            let kept = rows.into_iter().filter(|row| keep[*row as usize]);
            let states: Vec<u32> =
                kept.flat_map(|row| chunk.track_rows[row as usize].clone()).map(|state| state as u32).collect();
            if !states.is_empty() {
                self.sink.write(CorpusTable::Tracks, &partition, &taken(&chunk.tracks, &states)?)?;
            }
        }
        Ok(())
    }

    fn maps(&mut self, scan: &CorpusScan, wanted: &BTreeSet<String>) -> Result<()> {
        let maps = scan.maps()?;
        // A scenario may name a map without needing its lanes, so the corpus need not have that map.
        for id in maps.ids().filter(|id| wanted.contains(*id)) {
            let id = MapId::from(id);
            let lanes = maps.map(&id)?;
            match self.maps.get(&id.0) {
                Some(known) if *known == lanes => {}
                Some(_) => return Err(Error::MapConflict { id: id.0, dir: scan.dir().to_owned() }),
                None => {
                    self.sink.write_map(&id, &lanes)?;
                    self.maps.insert(id.0, lanes);
                }
            }
        }
        Ok(())
    }

    fn recordings(&mut self, scan: &CorpusScan, wanted: &BTreeSet<Fingerprint>) -> Result<()> {
        let mut here: BTreeMap<Fingerprint, blake3::Hasher> = BTreeMap::new();
        let mut came: BTreeSet<Fingerprint> = BTreeSet::new();
        for file in scan.manifest().files(CorpusTable::Recordings) {
            let path = scan.path(file);
            for batch in scan.batches(CorpusTable::Recordings, file, None)? {
                let batch = batch?;
                let scenes = texts(&batch, "scene_id", &path)?;
                let rows = match self.compares_recordings {
                    true => Some(RowBytes::new(&batch.schema(), &path)?.rows(&batch, &path)?),
                    false => None,
                };
                let (mut keep, mut n_scenes, mut start) = (vec![false; batch.num_rows()], 0, 0);
                while start < batch.num_rows() {
                    let end = run_end(scenes, start);
                    let scene = fingerprint(scenes.value(start).as_bytes());
                    if wanted.contains(&scene) {
                        if let Some(rows) = &rows {
                            add_rows(here.entry(scene).or_default(), rows, start..end);
                        }
                        if !self.recordings.contains_key(&scene) {
                            keep[start..end].fill(true);
                            n_scenes += u64::from(came.insert(scene));
                        }
                    }
                    start = end;
                }
                let kept = filter_record_batch(&batch, &BooleanArray::from(keep)).map_err(Error::arrow(&path))?;
                if kept.num_rows() > 0 {
                    self.sink.write_recordings(&file.partition, &kept, n_scenes)?;
                }
            }
        }
        for (scene, hasher) in here {
            let content = fingerprint(hasher.finalize().as_bytes());
            let known = *self.recordings.entry(scene).or_insert(content);
            self.n_differing_recordings += u64::from(known != content);
        }
        Ok(())
    }

    fn metrics(&mut self, scan: &CorpusScan, wanted: &BTreeSet<Fingerprint>) -> Result<()> {
        for file in scan.manifest().files(CorpusTable::Metrics) {
            let path = scan.path(file);
            for batch in scan.batches(CorpusTable::Metrics, file, None)? {
                let batch: RecordBatch = batch?;
                let ids = texts(&batch, "scenario_id", &path)?;
                self.n_aggregates_left_out += ids.null_count() as u64;
                let is_wanted = |id: Option<&str>| id.is_some_and(|id| wanted.contains(&fingerprint(id.as_bytes())));
                let keep: BooleanArray = ids.iter().map(|id| Some(is_wanted(id))).collect();
                let kept = filter_record_batch(&batch, &keep).map_err(Error::arrow(&path))?;
                if kept.num_rows() > 0 {
                    self.sink.write(CorpusTable::Metrics, &Partition::default(), &kept)?;
                }
            }
        }
        Ok(())
    }
}

/// The end of the run of rows that equal row `start`.
fn run_end(column: &arrow::array::StringArray, start: usize) -> usize {
    let value = column.value(start);
    (start + 1..column.len()).find(|row| column.value(*row) != value).unwrap_or(column.len())
}

/// The combined notes of several corpora: the terms of the remaining datasets, and notes with different values as a
/// list.
fn notes(manifests: &[&CorpusManifest], datasets: &BTreeSet<String>) -> CorpusNotes {
    let together = |of: fn(&CorpusManifest) -> &BTreeMap<String, String>, separator: &'static str| {
        let mut values: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (name, value) in manifests.iter().flat_map(|manifest| of(manifest)) {
            let known = values.entry(name.clone()).or_default();
            if !known.contains(value) {
                known.push(value.clone());
            }
        }
        values.into_iter().map(move |(name, values)| (name, values.join(separator)))
    };
    let mut left_out: BTreeMap<String, BTreeMap<String, u64>> = BTreeMap::new();
    for (sweep, reasons) in manifests.iter().flat_map(|manifest| &manifest.left_out) {
        let counts = left_out.entry(sweep.clone()).or_default();
        reasons.iter().for_each(|(reason, n)| *counts.entry(reason.clone()).or_default() += n);
    }
    CorpusNotes {
        sources: together(|m| &m.sources, " Also: ").filter(|(name, _)| datasets.contains(name)).collect(),
        notes: together(|m| &m.notes, ", ").collect(),
        left_out,
    }
}
