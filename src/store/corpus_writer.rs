//! Writes a corpus from scenarios: the tables that users query, and last the manifest.

use super::corpus_layout::CorpusTable;
use super::corpus_manifest::{CorpusManifest, CorpusNotes};
use super::corpus_sink::CorpusSink;
use super::fingerprint::{Fingerprint, fingerprint};
use super::parquet_file::{self, ParquetFile};
use super::row_file::ROWS_PER_BATCH;
use super::tables::scenario::ScenarioRows;
use super::tables::{metric, recording, sample, track};
use super::{Error, MapSource, Result};
use crate::files::remove_if_present;
use crate::metrics::MetricRow;
use crate::scenario::ScenarioRecord;
use crate::scene::{MapId, Scene};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Rows of scenarios that wait for the parameter columns.
const SPOOL_FILE: &str = "scenarios.spool";

/// Scenarios whose rows are encoded at a time.
const SCENARIOS_PER_BATCH: usize = 64;

/// Writes a corpus folder in bounded memory, apart from 16 bytes for the id of each scenario and scene. Rows of
/// scenarios are spooled to a file, because the parameter columns are known only at the end.
pub struct CorpusWriter<'m> {
    dir: PathBuf,
    maps: &'m dyn MapSource,
    sink: CorpusSink,
    spool: ParquetFile,
    parameters: BTreeSet<String>,
    scenario_ids: BTreeSet<Fingerprint>,
    known_maps: BTreeSet<MapId>,
    known_scenes: BTreeSet<Fingerprint>,
}

impl<'m> CorpusWriter<'m> {
    /// Begins a corpus in `dir`, which is created if it is missing. Files of an interrupted attempt are removed if they
    /// are on a list of ours. Maps are copied from `maps` as scenarios need them.
    ///
    /// # Errors
    /// [`Error::Files`] when the folder holds foreign files; errors of the file system.
    pub fn create(dir: &Path, maps: &'m dyn MapSource) -> Result<Self> {
        let sink = CorpusSink::create(dir)?;
        let spool = dir.join(SPOOL_FILE);
        Ok(Self {
            dir: dir.to_owned(),
            maps,
            sink,
            spool: ParquetFile::create(&spool, &CorpusTable::Scenarios.schema(), ScenarioRows::spool_schema())?,
            parameters: BTreeSet::new(),
            scenario_ids: BTreeSet::new(),
            known_maps: BTreeSet::new(),
            known_scenes: BTreeSet::new(),
        })
    }

    /// Limits files to this many scenarios or scenes.
    #[cfg(test)]
    pub(crate) fn in_files_of(self, scenes_per_file: usize) -> Self {
        Self { sink: self.sink.in_files_of(scenes_per_file), ..self }
    }

    /// Adds scenarios, in the given order.
    ///
    /// # Errors
    /// [`Error::Invalid`] when an id occurs twice or a record would not be read back unchanged; errors of the maps and
    /// of the file system.
    pub fn write_scenarios(&mut self, records: &[ScenarioRecord]) -> Result<()> {
        for batch in records.chunks(SCENARIOS_PER_BATCH) {
            for record in batch {
                self.register(record)?;
                let place = &record.scenario.scene.source.place;
                let partition = CorpusTable::Tracks.partition(record.requested_behavior.as_deref(), place);
                self.sink.write(CorpusTable::Tracks, &partition, &track::encode(record)?)?;
            }
            let rows = ScenarioRows::new(batch)?;
            self.parameters.extend(rows.parameters()?.into_iter().map(str::to_owned));
            self.spool.write(&rows.into_spooled()?)?;
        }
        Ok(())
    }

    /// Adds the recorded scene that scenarios continue. A scene that was added before is skipped.
    pub fn write_recording(&mut self, scene: &Scene) -> Result<()> {
        if !self.known_scenes.insert(fingerprint(scene.id.0.as_bytes())) {
            return Ok(());
        }
        let partition = CorpusTable::Recordings.partition(None, &scene.source.place);
        self.sink.write_recordings(&partition, &recording::encode(scene)?, 1)
    }

    /// Adds metric values, in the given order, except those of scenarios that have not been added.
    ///
    /// # Errors
    /// Errors of the rows, and I/O errors.
    pub fn write_metrics(&mut self, rows: impl IntoIterator<Item = Result<MetricRow>>) -> Result<()> {
        let Self { scenario_ids, sink, .. } = self;
        let partition = CorpusTable::Metrics.partition(None, "");
        let is_left_out = |row: &MetricRow| {
            row.scenario_id.as_ref().is_some_and(|id| !scenario_ids.contains(&fingerprint(id.as_bytes())))
        };
        let mut rows = rows.into_iter().filter(|row| !row.as_ref().is_ok_and(is_left_out)).peekable();
        while rows.peek().is_some() {
            let batch: Vec<MetricRow> = rows.by_ref().take(ROWS_PER_BATCH).collect::<Result<_>>()?;
            sink.write(CorpusTable::Metrics, &partition, &metric::encode(&batch)?)?;
        }
        Ok(())
    }

    /// Finishes the tables, and writes the card and the manifest.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a parameter has the name of another column; errors of the file system.
    pub fn finish(mut self, notes: &CorpusNotes) -> Result<CorpusManifest> {
        self.spool.finish()?;
        let path = self.dir.join(SPOOL_FILE);
        let names: BTreeSet<&str> = self.parameters.iter().map(String::as_str).collect();
        for batch in parquet_file::stream(&path, &CorpusTable::Scenarios.schema(), None)? {
            let rows = ScenarioRows::from_spooled(&batch?, &path)?;
            self.sink.write_scenarios(&rows.into_batch(&names)?)?;
        }
        remove_if_present(&path)?;
        self.sink.finish(notes, &[])
    }

    /// Registers a scenario, and writes its map if it is the first to need it.
    fn register(&mut self, record: &ScenarioRecord) -> Result<()> {
        sample::check(record)?;
        let scene = &record.scenario.scene;
        if !self.scenario_ids.insert(fingerprint(record.scenario.id.as_bytes())) {
            return Err(Error::invalid(&record.scenario.id, "another scenario has this id"));
        }
        if let Some(map_id) = &scene.map_id
            && !scene.lanes.is_empty()
            && self.known_maps.insert(map_id.clone())
        {
            self.sink.write_map(map_id, &self.maps.map(map_id)?)?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "corpus_writer_tests.rs"]
mod tests;
