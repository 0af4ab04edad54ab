//! Writing a corpus: the tables that users query, and the manifest that says they are whole.

use super::atomic::{FileStamp, remove_if_present, remove_partials, write_json_atomically};
use super::corpus_manifest::{CorpusManifest, CorpusNotes, TableEntry, source_terms};
use super::parquet_file::ParquetFile;
use super::scene_manifest::MANIFEST_FILE;
use super::schema::TableSchema;
use super::tables::scenario::ScenarioRows;
use super::tables::{lane, metric, sample, scenario, track};
use super::{Error, MapSource, MetricRow, Result, ScenarioRecord};
use crate::scene::MapId;
use fs_err as fs;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The table of scenarios.
pub(crate) const SCENARIOS_FILE: &str = "scenarios.parquet";
/// The table of tracks.
pub(crate) const TRACKS_FILE: &str = "tracks.parquet";
/// The table of metric values.
pub(crate) const METRICS_FILE: &str = "metrics.parquet";
/// The table of lanes.
pub(crate) const LANES_FILE: &str = "lanes.parquet";

/// Scenarios whose tracks are encoded at a time.
const SCENARIOS_PER_BATCH: usize = 64;

/// Writes a corpus folder. Tracks, lanes and metric values are written as they come; the rows of scenarios, some hundred
/// bytes each, wait in memory because the columns of parameters are known only at the end.
pub struct CorpusWriter<'m> {
    dir: PathBuf,
    maps: &'m dyn MapSource,
    tracks: ParquetFile,
    lanes: ParquetFile,
    metrics: ParquetFile,
    scenarios: Vec<ScenarioRows>,
    scenario_ids: BTreeSet<String>,
    known_maps: BTreeSet<MapId>,
    manifest: CorpusManifest,
}

impl<'m> CorpusWriter<'m> {
    /// Begins a corpus in `dir`, which is created where it is missing; the files of an earlier one are removed. Maps are
    /// copied from `maps` as scenarios need them.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn create(dir: &Path, maps: &'m dyn MapSource) -> Result<Self> {
        fs::create_dir_all(dir)?;
        for file in [MANIFEST_FILE, SCENARIOS_FILE, TRACKS_FILE, METRICS_FILE, LANES_FILE] {
            remove_if_present(&dir.join(file))?;
        }
        remove_partials(dir)?;
        let table = |file: &str, schema: &TableSchema| ParquetFile::create(&dir.join(file), schema, schema.arrow());
        Ok(Self {
            dir: dir.to_owned(),
            maps,
            tracks: table(TRACKS_FILE, &track::schema())?,
            lanes: table(LANES_FILE, &lane::schema())?,
            metrics: table(METRICS_FILE, &metric::schema())?,
            scenarios: Vec::new(),
            scenario_ids: BTreeSet::new(),
            known_maps: BTreeSet::new(),
            manifest: CorpusManifest::empty(),
        })
    }

    /// Adds scenarios, in the order given.
    ///
    /// # Errors
    /// [`Error::Invalid`] when an id occurs twice or a record would not be read back as it is; those of the maps and of the
    /// file system.
    pub fn write_scenarios(&mut self, records: &[ScenarioRecord]) -> Result<()> {
        for batch in records.chunks(SCENARIOS_PER_BATCH) {
            for record in batch {
                self.register(record)?;
            }
            self.tracks.write(&track::encode(batch)?)?;
            self.scenarios.push(ScenarioRows::new(batch)?);
        }
        Ok(())
    }

    /// Adds metric values, in the order given.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn write_metrics(&mut self, rows: &[MetricRow]) -> Result<()> {
        self.metrics.write(&metric::encode(rows)?)
    }

    /// Finishes the tables and writes the manifest.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a parameter has the name of another column; those of the file system.
    pub fn finish(mut self, notes: &CorpusNotes) -> Result<CorpusManifest> {
        let (n_rows, stamp) = write_scenario_table(&self.dir.join(SCENARIOS_FILE), self.scenarios)?;
        let mut add = |file: &str, schema: &TableSchema, n_rows: u64, stamp: FileStamp| {
            self.manifest.tables.insert(file.to_owned(), TableEntry { schema: schema.id(), n_rows, stamp });
        };
        add(SCENARIOS_FILE, &scenario::schema(), n_rows, stamp);
        add(TRACKS_FILE, &track::schema(), self.tracks.n_rows(), self.tracks.finish()?);
        add(METRICS_FILE, &metric::schema(), self.metrics.n_rows(), self.metrics.finish()?);
        add(LANES_FILE, &lane::schema(), self.lanes.n_rows(), self.lanes.finish()?);
        self.manifest.n_maps = self.known_maps.len() as u64;
        self.manifest.sources.extend(notes.sources.clone());
        self.manifest.notes.clone_from(&notes.notes);
        write_json_atomically(&self.dir.join(MANIFEST_FILE), &self.manifest)?;
        Ok(self.manifest)
    }

    /// Counts a scenario and writes its map when it is the first to need it.
    fn register(&mut self, record: &ScenarioRecord) -> Result<()> {
        sample::check(record)?;
        let scene = &record.scenario.scene;
        if !self.scenario_ids.insert(record.scenario.id.clone()) {
            return Err(Error::invalid(&record.scenario.id, "another scenario has this id"));
        }
        if let Some(map_id) = &scene.map_id
            && !scene.lanes.is_empty()
            && self.known_maps.insert(map_id.clone())
        {
            self.lanes.write(&lane::encode(&[(map_id, &self.maps.map(map_id)?)])?)?;
        }
        let dataset = scene.source.dataset;
        let manifest = &mut self.manifest;
        manifest.n_scenarios += 1;
        manifest.n_verified += u64::from(record.verified);
        *manifest.scenarios_by_dataset.entry(dataset.name().to_owned()).or_default() += 1;
        *manifest.scenarios_by_sweep.entry(record.sweep.clone()).or_default() += 1;
        manifest.sources.entry(dataset.name().to_owned()).or_insert_with(|| source_terms(dataset).to_owned());
        Ok(())
    }
}

/// Writes the rows of all scenarios with the columns of all parameters that occur.
fn write_scenario_table(path: &Path, batches: Vec<ScenarioRows>) -> Result<(u64, FileStamp)> {
    let mut names = BTreeSet::new();
    for rows in &batches {
        names.extend(rows.parameters()?.into_iter().map(str::to_owned));
    }
    let names: BTreeSet<&str> = names.iter().map(String::as_str).collect();
    let mut file = ParquetFile::create(path, &scenario::schema(), ScenarioRows::schema_with(&names))?;
    for rows in batches {
        file.write(&rows.into_batch(&names)?)?;
    }
    Ok((file.n_rows(), file.finish()?))
}
