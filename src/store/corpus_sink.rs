//! Writes rows to the files of a corpus: in partitions, in bounded memory, with the same bytes whatever batches the
//! rows arrive in.

use super::atomic::write_json_atomically;
use super::corpus_card::{CARD_FILE, card};
use super::corpus_layout::{CorpusTable, NO_BEHAVIOR, Partition, SCENES_PER_FILE};
use super::corpus_manifest::{CorpusManifest, CorpusNotes, FileEntry, PartitionCount, TableEntry};
use super::parquet_file::ParquetFile;
use super::scene_manifest::MANIFEST_FILE;
use super::tables::columns::Columns;
use super::tables::lane;
use super::{Error, Result};
use crate::files::{clear, write_atomically};
use crate::scene::{Dataset, LaneGraph, MapId};
use arrow::array::{Array, RecordBatch, StringArray, UInt32Array};
use arrow::compute::{concat_batches, take_record_batch};
use arrow::datatypes::SchemaRef;
use fs_err as fs;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows to write at a time, so that pages break at the same rows whatever the sizes of incoming batches.
const ROWS_PER_WRITE: usize = 4 * 1024;
/// The most bytes of unfinished row groups over all files. Beyond it, the largest row group is ended early.
const MAX_BYTES_IN_MEMORY: usize = 16 << 20;

/// Writes the tables of a corpus. Memory is bounded by the number of open files, one for each partition, not by the
/// number of rows.
pub(crate) struct CorpusSink {
    dir: PathBuf,
    scenes_per_file: usize,
    parts: BTreeMap<(CorpusTable, Partition), OpenFile>,
    /// The finished files, with their numbers.
    files: BTreeMap<(CorpusTable, Partition, usize), FileEntry>,
    counts: BTreeMap<(String, String), PartitionCount>,
    manifest: CorpusManifest,
    /// The columns of scenarios, for a corpus without scenarios.
    scenario_schema: SchemaRef,
}

/// A file that is being written, and the rows to write next.
struct OpenFile {
    file: ParquetFile,
    path: PathBuf,
    number: usize,
    /// Scenarios or scenes so far.
    n_units: usize,
    /// The last scenario or scene.
    last_unit: String,
    pending: Vec<RecordBatch>,
    n_pending: usize,
}

impl CorpusSink {
    /// Begins a corpus in `dir`, which is created if it is missing. Files of an interrupted attempt are removed if they
    /// are on a list of ours; any other file is an error.
    pub(crate) fn create(dir: &Path) -> Result<Self> {
        clear(dir)?;
        let (parts, files, counts) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let (manifest, scenario_schema) = (CorpusManifest::empty(), CorpusTable::Scenarios.schema().arrow());
        let (dir, scenes_per_file) = (dir.to_owned(), SCENES_PER_FILE);
        Ok(Self { dir, scenes_per_file, parts, files, counts, manifest, scenario_schema })
    }

    /// Limits files to this many scenarios or scenes.
    #[cfg(test)]
    pub(crate) fn in_files_of(self, scenes_per_file: usize) -> Self {
        Self { scenes_per_file, ..self }
    }

    /// Adds rows of scenarios to their partitions and counts them. Their columns must be the same in all calls.
    pub(crate) fn write_scenarios(&mut self, batch: &RecordBatch) -> Result<()> {
        let path = self.dir.join(CorpusTable::Scenarios.name());
        self.scenario_schema = batch.schema();
        self.count(&Columns::of_batch(batch, &path), batch.num_rows())?;
        for (partition, rows) in partitioned(batch, &path)? {
            self.write(CorpusTable::Scenarios, &partition, &taken(batch, &rows)?)?;
        }
        Ok(())
    }

    /// Adds the rows of whole recorded scenes.
    pub(crate) fn write_recordings(&mut self, partition: &Partition, batch: &RecordBatch, n_scenes: u64) -> Result<()> {
        self.manifest.n_recordings += n_scenes;
        self.write(CorpusTable::Recordings, partition, batch)
    }

    pub(crate) fn write_map(&mut self, id: &MapId, lanes: &LaneGraph) -> Result<()> {
        self.manifest.n_maps += 1;
        self.write(CorpusTable::Lanes, &Partition::default(), &lane::encode(&[(id, lanes)])?)
    }

    /// Adds rows to the files of a partition, without the columns that its folder's name holds. All rows of a scenario
    /// or scene must be consecutive.
    pub(crate) fn write(&mut self, table: CorpusTable, partition: &Partition, batch: &RecordBatch) -> Result<()> {
        let mut rest = without(batch, table.keys())?;
        let key = (table, partition.clone());
        if !self.parts.contains_key(&key) {
            self.parts.insert(key.clone(), OpenFile::create(&self.dir, table, partition, 0, &rest)?);
        }
        while let Some(part) = self.parts.get_mut(&key) {
            let n_rows = part.n_rows_that_fit(table, &rest, self.scenes_per_file)?;
            part.push(rest.slice(0, n_rows))?;
            if n_rows == rest.num_rows() {
                break;
            }
            rest = rest.slice(n_rows, rest.num_rows() - n_rows);
            let next = OpenFile::create(&self.dir, table, partition, part.number + 1, &rest)?;
            let full = std::mem::replace(part, next);
            self.files.insert((table, partition.clone(), full.number), full.finish(table, partition)?);
        }
        self.limit_memory()
    }

    /// Ends the largest unfinished row group while too much is in memory. The choice depends only on the order of the
    /// rows, so equal corpora stay equal.
    fn limit_memory(&mut self) -> Result<()> {
        let size = |part: &OpenFile| part.file.n_bytes_in_memory();
        while self.parts.values().map(size).sum::<usize>() > MAX_BYTES_IN_MEMORY {
            // The last by name among equally large ones.
            let largest = self.parts.values_mut().max_by_key(|part| size(part));
            let Some(part) = largest else { break };
            part.file.flush()?;
        }
        Ok(())
    }

    fn count(&mut self, columns: &Columns<'_>, n_rows: usize) -> Result<()> {
        for row in 0..n_rows {
            let verified = columns.flag("verified", row)?;
            let is_new = verified && !columns.flag("recorded_event", row)?;
            let dataset = columns.text("dataset", row)?;
            let behavior = columns.optional_text("requested_behavior", row)?.unwrap_or(NO_BEHAVIOR);
            let (behavior, place) = (behavior.to_owned(), columns.text("place", row)?.to_owned());
            let manifest = &mut self.manifest;
            manifest.n_scenarios += 1;
            manifest.n_verified += u64::from(verified);
            manifest.n_new += u64::from(is_new);
            *manifest.scenarios_by_dataset.entry(dataset.to_owned()).or_default() += 1;
            *manifest.scenarios_by_sweep.entry(columns.text("sweep", row)?.to_owned()).or_default() += 1;
            let count = self.counts.entry((behavior.clone(), place.clone())).or_insert(PartitionCount {
                behavior,
                place,
                n_scenarios: 0,
                n_verified: 0,
                n_new: 0,
            });
            count.n_scenarios += 1;
            count.n_verified += u64::from(verified);
            count.n_new += u64::from(is_new);
        }
        Ok(())
    }

    /// Finishes the files, and writes the card and, last, the manifest. A table without rows gets an empty file, so
    /// that queries find its columns; so does a table whose places readers could take for other types than text.
    pub(crate) fn finish(mut self, about: &CorpusNotes, history: &[String]) -> Result<CorpusManifest> {
        for table in CorpusTable::ALL {
            if !self.parts.keys().any(|(other, partition)| *other == table && partition.has_place_in_words()) {
                let schema = match table {
                    CorpusTable::Scenarios => Arc::clone(&self.scenario_schema),
                    _ => table.schema().arrow(),
                };
                let empty = RecordBatch::new_empty(schema);
                self.write(table, &table.partition_without_rows(), &empty)?;
            }
        }
        for ((table, partition), part) in self.parts {
            let file = (part.number, part.finish(table, &partition)?);
            self.files.insert((table, partition, file.0), file.1);
        }
        let mut manifest = self.manifest;
        for ((table, ..), file) in self.files {
            let entry = manifest.tables.entry(table.name().to_owned()).or_insert_with(|| TableEntry {
                schema: table.schema().id(),
                n_rows: 0,
                n_bytes: 0,
                partitioned_by: table.keys().iter().map(|key| (*key).to_owned()).collect(),
                files: Vec::new(),
            });
            entry.n_rows += file.n_rows;
            entry.n_bytes += file.stamp.n_bytes;
            entry.files.push(file);
        }
        manifest.scenarios_by_partition = self.counts.into_values().collect();
        for name in manifest.scenarios_by_dataset.keys() {
            let of_dataset = || Dataset::from_name(name).map(|dataset| dataset.facts().terms.to_owned());
            let terms = about.sources.get(name).cloned().or_else(of_dataset);
            let terms = terms.unwrap_or_else(|| "unknown: find out before you use it".to_owned());
            manifest.sources.insert(name.clone(), terms);
        }
        manifest.notes.clone_from(&about.notes);
        manifest.left_out.clone_from(&about.left_out);
        manifest.history = history.to_vec();
        write_atomically::<Error>(&self.dir.join(CARD_FILE), |file| Ok(file.write_all(card(&manifest).as_bytes())?))?;
        write_json_atomically(&self.dir.join(MANIFEST_FILE), &manifest)?;
        Ok(manifest)
    }
}

impl OpenFile {
    fn create(
        dir: &Path,
        table: CorpusTable,
        partition: &Partition,
        number: usize,
        batch: &RecordBatch,
    ) -> Result<Self> {
        let path = dir.join(table.file(partition, number));
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let file = ParquetFile::create(&path, &table.file_schema(), batch.schema())?;
        Ok(Self { file, path, number, n_units: 0, last_unit: String::new(), pending: Vec::new(), n_pending: 0 })
    }

    /// The number of these rows that fit into the file, which ends when it has `n_max` whole scenarios or scenes.
    /// Counts the scenarios or scenes that begin in them.
    fn n_rows_that_fit(&mut self, table: CorpusTable, rows: &RecordBatch, n_max: usize) -> Result<usize> {
        let Some(unit) = table.unit() else { return Ok(rows.num_rows()) };
        let ids: &StringArray = Columns::of_batch(rows, &self.path).get(unit)?;
        for row in 0..ids.len() {
            if self.n_units > 0 && ids.value(row) == self.last_unit {
                continue;
            }
            if self.n_units == n_max {
                return Ok(row);
            }
            self.n_units += 1;
            ids.value(row).clone_into(&mut self.last_unit);
        }
        Ok(ids.len())
    }

    /// Adds rows; writes full portions.
    fn push(&mut self, rows: RecordBatch) -> Result<()> {
        self.n_pending += rows.num_rows();
        self.pending.push(rows);
        while self.n_pending >= ROWS_PER_WRITE {
            self.write_pending(ROWS_PER_WRITE)?;
        }
        Ok(())
    }

    /// Writes the first `n_rows` of the waiting rows.
    fn write_pending(&mut self, n_rows: usize) -> Result<()> {
        let Some(first) = self.pending.first() else { return Ok(()) };
        let all = concat_batches(&first.schema(), &self.pending)
            .map_err(|error| Error::invalid(&self.path.display(), error.to_string()))?;
        self.file.write(&all.slice(0, n_rows))?;
        self.n_pending -= n_rows;
        self.pending.clear();
        if self.n_pending > 0 {
            self.pending.push(all.slice(n_rows, self.n_pending));
        }
        Ok(())
    }

    fn finish(mut self, table: CorpusTable, partition: &Partition) -> Result<FileEntry> {
        self.write_pending(self.n_pending)?;
        let (path, n_rows) = (table.file(partition, self.number), self.file.n_rows());
        Ok(FileEntry { path, partition: partition.clone(), n_rows, stamp: self.file.finish()? })
    }
}

/// The rows of scenarios of each partition, in the order of partitions.
pub(crate) fn partitioned(batch: &RecordBatch, path: &Path) -> Result<BTreeMap<Partition, Vec<u32>>> {
    let columns = Columns::of_batch(batch, path);
    let mut rows: BTreeMap<Partition, Vec<u32>> = BTreeMap::new();
    for row in 0..batch.num_rows() {
        let behavior = columns.optional_text("requested_behavior", row)?;
        let partition = CorpusTable::Scenarios.partition(behavior, columns.text("place", row)?);
        rows.entry(partition).or_default().push(row as u32);
    }
    Ok(rows)
}

fn without(batch: &RecordBatch, columns: &[&str]) -> Result<RecordBatch> {
    let schema = batch.schema();
    let fields = schema.fields().iter().enumerate();
    let kept: Vec<usize> =
        fields.filter(|(_, field)| !columns.contains(&field.name().as_str())).map(|(i, _)| i).collect();
    batch.project(&kept).map_err(|error| Error::invalid("rows", error.to_string()))
}

pub(crate) fn taken(batch: &RecordBatch, rows: &[u32]) -> Result<RecordBatch> {
    if rows.len() == batch.num_rows() {
        return Ok(batch.clone());
    }
    take_record_batch(batch, &UInt32Array::from(rows.to_vec()))
        .map_err(|error| Error::invalid("rows", error.to_string()))
}
