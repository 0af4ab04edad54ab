//! Reads the rows of a corpus in order, a few scenarios at a time, each with its states.

use super::atomic::is_missing;
use super::corpus_layout::CorpusTable;
use super::corpus_manifest::{CorpusManifest, FileEntry};
use super::maps::MapTable;
use super::parquet_file::{self, Batches};
use super::scene_manifest::MANIFEST_FILE;
use super::schema::TableSchema;
use super::tables::columns::Columns;
use super::{Error, Result};
use arrow::array::{Array, RecordBatch, StringArray, UInt64Array, new_null_array};
use arrow::compute::concat_batches;
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use fs_err as fs;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Scenarios that are read at a time.
const SCENARIOS_PER_CHUNK: usize = 64;

/// A finished corpus, read from beginning to end.
pub(crate) struct CorpusScan {
    dir: PathBuf,
    manifest: CorpusManifest,
}

/// Some scenarios and all of their states.
pub(crate) struct CorpusChunk {
    /// The file of the scenarios.
    pub(crate) path: PathBuf,
    /// Position of the first scenario in its file.
    pub(crate) first_row: usize,
    pub(crate) scenarios: RecordBatch,
    /// The file of the states.
    pub(crate) tracks_path: PathBuf,
    /// Position of the first state in its file.
    pub(crate) first_track_row: usize,
    /// The states; without columns if they were not requested.
    pub(crate) tracks: RecordBatch,
    /// The rows of states of each scenario.
    pub(crate) track_rows: Vec<Range<usize>>,
}

impl CorpusScan {
    /// Opens a finished corpus and verifies the checksums of all of its files.
    pub(crate) fn open(dir: &Path) -> Result<Self> {
        let scan = Self::open_unverified(dir)?;
        let files: Vec<&FileEntry> = scan.manifest.all_files().collect();
        files.par_iter().try_for_each(|file| scan.verify(file))?;
        Ok(scan)
    }

    /// Opens a corpus and reads only its manifest.
    pub(crate) fn open_unverified(dir: &Path) -> Result<Self> {
        Ok(Self { dir: dir.to_owned(), manifest: CorpusManifest::read(dir)? })
    }

    /// Checks the size and checksum of a file.
    pub(crate) fn verify(&self, file: &FileEntry) -> Result<()> {
        let path = self.path(file);
        match fs_err::metadata(&path) {
            Ok(metadata) if metadata.is_file() => file.stamp.verify_file(&path),
            Err(error) if !is_missing(&error) => Err(error.into()),
            _ => Err(Error::corrupt(&path, "the file is missing")),
        }
    }

    pub(crate) const fn manifest(&self) -> &CorpusManifest {
        &self.manifest
    }

    pub(crate) fn dir(&self) -> &Path {
        &self.dir
    }

    /// Hash of the manifest, and through its checksums of every table; hexadecimal.
    pub(crate) fn fingerprint(&self) -> Result<String> {
        Ok(blake3::hash(&fs::read(self.dir.join(MANIFEST_FILE))?).to_hex()[..16].to_owned())
    }

    pub(crate) fn path(&self, file: &FileEntry) -> PathBuf {
        self.dir.join(&file.path)
    }

    /// Number of files of scenarios.
    pub(crate) fn n_parts(&self) -> usize {
        self.manifest.files(CorpusTable::Scenarios).len()
    }

    /// The files of part `i`: its scenarios and their states.
    pub(crate) fn part(&self, i: usize) -> Result<(&FileEntry, &FileEntry)> {
        let file = |table: CorpusTable| {
            let files = self.manifest.files(table);
            let missing = || Error::corrupt(&self.dir, format!("part {i} of {} is missing", table.name()));
            files.get(i).ok_or_else(missing)
        };
        let (scenarios, tracks) = (file(CorpusTable::Scenarios)?, file(CorpusTable::Tracks)?);
        if scenarios.partition == tracks.partition {
            Ok((scenarios, tracks))
        } else {
            Err(Error::corrupt(&self.dir, format!("{} and {} do not belong together", scenarios.path, tracks.path)))
        }
    }

    /// The scenarios of part `i`, with their states on request.
    pub(crate) fn chunks(&self, i: usize, with_tracks: bool) -> Result<Chunks> {
        let (scenarios, tracks) = self.part(i)?;
        let (path, tracks_path) = (self.path(scenarios), self.path(tracks));
        let batches = self.batches(CorpusTable::Scenarios, scenarios, None)?;
        let feed = if with_tracks { Some(self.batches(CorpusTable::Tracks, tracks, None)?) } else { None };
        Ok(Chunks { path, scenarios: Feed::new(batches), tracks_path, tracks: feed.map(Feed::new), is_over: false })
    }

    /// All scenarios, part by part, with their states on request.
    pub(crate) fn all_chunks(&self, with_tracks: bool) -> impl Iterator<Item = Result<CorpusChunk>> {
        (0..self.n_parts()).flat_map(move |i| {
            let (chunks, error) = match self.chunks(i, with_tracks) {
                Ok(chunks) => (Some(chunks), None),
                Err(error) => (None, Some(Err(error))),
            };
            chunks.into_iter().flatten().chain(error)
        })
    }

    /// The batches of a file, with the values in the name of its folder: whole rows, or only some columns.
    pub(crate) fn batches(
        &self,
        table: CorpusTable,
        file: &FileEntry,
        columns: Option<&[&str]>,
    ) -> Result<PartBatches> {
        let path = self.path(file);
        let batches = parquet_file::stream(&path, &table.file_schema(), columns)?;
        let schema = table.schema();
        let is_wanted = |key: &&&str| schema.has(key) && columns.is_none_or(|columns| columns.contains(*key));
        let keys = table.keys().iter().filter(is_wanted).map(|key| (*key, file.partition.value(key).to_owned()));
        let keys = keys.collect();
        Ok(PartBatches { path, batches, keys, schema: columns.is_none().then_some(schema) })
    }

    /// The number of rows of a file, from its footer.
    pub(crate) fn n_rows(&self, table: CorpusTable, file: &FileEntry) -> Result<u64> {
        parquet_file::n_rows(&self.path(file), &table.file_schema())
    }

    /// The columns of all scenarios: those of the table, then every parameter that occurs in a file, sorted.
    pub(crate) fn scenario_schema(&self) -> Result<SchemaRef> {
        let files = self.manifest.files(CorpusTable::Scenarios).iter();
        let schemas = files.map(|file| parquet_file::schema(&self.path(file), &CorpusTable::Scenarios.file_schema()));
        Ok(united(&schemas.collect::<Result<Vec<_>>>()?))
    }

    pub(crate) fn maps(&self) -> Result<MapTable> {
        let mut maps = MapTable::new(&self.dir);
        for file in self.manifest.files(CorpusTable::Lanes) {
            for batch in self.batches(CorpusTable::Lanes, file, None)? {
                maps.push(&self.path(file), batch?)?;
            }
        }
        Ok(maps)
    }
}

/// The batches of a file of a corpus.
pub(crate) struct PartBatches {
    path: PathBuf,
    batches: Batches,
    /// Columns in the name of the folder, with their values.
    keys: Vec<(&'static str, String)>,
    /// All columns in their order; `None` if only some are read.
    schema: Option<TableSchema>,
}

impl PartBatches {
    fn with_keys(&self, batch: &RecordBatch) -> Result<RecordBatch> {
        let mut fields = batch.schema().fields().to_vec();
        let mut columns = batch.columns().to_vec();
        for (key, value) in self.keys.iter().filter(|(key, _)| batch.column_by_name(key).is_none()) {
            fields.push(Arc::new(Field::new(*key, DataType::Utf8, false)));
            columns.push(Arc::new(StringArray::from_iter_values(std::iter::repeat_n(value, batch.num_rows()))));
        }
        let schema = Arc::new(Schema::new_with_metadata(fields, batch.schema().metadata().clone()));
        let batch = RecordBatch::try_new(schema, columns).map_err(|error| Error::unreadable(&self.path, error))?;
        self.schema.as_ref().map_or(Ok(batch.clone()), |schema| schema.conform(&self.path, &batch))
    }
}

impl Iterator for PartBatches {
    type Item = Result<RecordBatch>;

    fn next(&mut self) -> Option<Self::Item> {
        let batch = self.batches.next()?;
        Some(if self.keys.is_empty() { batch } else { batch.and_then(|batch| self.with_keys(&batch)) })
    }
}

/// The columns of the scenario table, then all other columns of `schemas`, sorted by name.
pub(crate) fn united(schemas: &[SchemaRef]) -> SchemaRef {
    let table = CorpusTable::Scenarios.schema();
    let open: BTreeMap<&str, &Field> =
        schemas.iter().flat_map(|schema| table.open_of(schema)).map(|field| (field.name().as_str(), field)).collect();
    table.arrow_with(open.into_values().cloned().collect())
}

/// The rows with the columns of `schema`; missing columns have no value in any row.
pub(crate) fn widened(batch: &RecordBatch, schema: &SchemaRef, path: &Path) -> Result<RecordBatch> {
    let column = |field: &Arc<Field>| {
        batch
            .column_by_name(field.name())
            .cloned()
            .unwrap_or_else(|| new_null_array(field.data_type(), batch.num_rows()))
    };
    let columns = schema.fields().iter().map(column).collect();
    RecordBatch::try_new(Arc::clone(schema), columns).map_err(|error| Error::unreadable(path, error))
}

/// The scenarios of a file, some at a time. They end after the first error.
pub(crate) struct Chunks {
    path: PathBuf,
    scenarios: Feed,
    tracks_path: PathBuf,
    tracks: Option<Feed>,
    is_over: bool,
}

impl Chunks {
    fn read(&mut self) -> Result<Option<CorpusChunk>> {
        let first_row = self.scenarios.n_taken;
        let Some(scenarios) = self.scenarios.take(SCENARIOS_PER_CHUNK, &self.path)? else {
            let n_states = self.tracks.as_ref().map_or(0, |tracks| tracks.n_taken);
            let rest = self.tracks.as_mut().map(|tracks| tracks.take(1, &self.tracks_path)).transpose()?;
            return match rest.flatten() {
                Some(_) => {
                    let detail = format!("its rows from row {n_states} on belong to no scenario");
                    Err(Error::corrupt(&self.tracks_path, detail))
                }
                None => Ok(None),
            };
        };
        let columns = Columns::of_batch(&scenarios, &self.path);
        let n_states: &UInt64Array = columns.get("n_states")?;
        let mut end = 0usize;
        let track_rows: Vec<Range<usize>> = n_states
            .values()
            .iter()
            .map(|n| {
                let start = end;
                // A damaged number must not overflow; the missing rows reveal it.
                end = end.saturating_add(*n as usize);
                start..end
            })
            .collect();
        let mut chunk = CorpusChunk {
            path: self.path.clone(),
            first_row,
            tracks_path: self.tracks_path.clone(),
            first_track_row: 0,
            tracks: RecordBatch::new_empty(Arc::new(arrow::datatypes::Schema::empty())),
            track_rows,
            scenarios,
        };
        if let Some(tracks) = &mut self.tracks {
            chunk.first_track_row = tracks.n_taken;
            let rows = tracks.take(end, &self.tracks_path)?;
            chunk.tracks = rows.unwrap_or_else(|| RecordBatch::new_empty(CorpusTable::Tracks.schema().arrow()));
            chunk.check_order(end)?;
        }
        Ok(Some(chunk))
    }
}

impl Iterator for Chunks {
    type Item = Result<CorpusChunk>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_over {
            return None;
        }
        let chunk = self.read().transpose();
        self.is_over = !matches!(chunk, Some(Ok(_)));
        chunk
    }
}

impl CorpusChunk {
    pub(crate) fn len(&self) -> usize {
        self.scenarios.num_rows()
    }

    pub(crate) fn columns(&self) -> Columns<'_> {
        Columns::of_batch(&self.scenarios, &self.path)
    }

    /// Checks that the states match the scenarios in number and order.
    fn check_order(&self, n_states: usize) -> Result<()> {
        let tracks = Columns::of_batch(&self.tracks, &self.tracks_path);
        let of_tracks: &StringArray = tracks.get("scenario_id")?;
        if of_tracks.len() < n_states {
            let n_rows = self.first_track_row + of_tracks.len();
            let detail = format!("it ends after {n_rows} rows, before the last states of its scenarios");
            return Err(Error::corrupt(&self.tracks_path, detail));
        }
        let scenarios = self.columns();
        for (i, rows) in self.track_rows.iter().enumerate().filter(|(_, rows)| !rows.is_empty()) {
            let id = scenarios.text("scenario_id", i)?;
            for row in [rows.start, rows.end - 1] {
                let found = of_tracks.value(row);
                if found != id {
                    let row = self.first_track_row + row;
                    let detail =
                        format!("row {row} is of scenario {found}, expected {id} as in {}", self.path.display());
                    return Err(Error::corrupt(&self.tracks_path, detail));
                }
            }
        }
        Ok(())
    }
}

/// Returns the rows of a file in portions of any size.
struct Feed {
    batches: PartBatches,
    /// The rest of the last batch.
    rest: Option<RecordBatch>,
    n_taken: usize,
}

impl Feed {
    const fn new(batches: PartBatches) -> Self {
        Self { batches, rest: None, n_taken: 0 }
    }

    /// The next `n` rows, or as many as there are; `None` at the end, and for no rows.
    fn take(&mut self, n: usize, path: &Path) -> Result<Option<RecordBatch>> {
        let (mut taken, mut n_missing) = (Vec::new(), n);
        while n_missing > 0 {
            let batch = match self.rest.take() {
                Some(rest) => rest,
                None => match self.batches.next() {
                    Some(batch) => batch?,
                    None => break,
                },
            };
            let n_here = n_missing.min(batch.num_rows());
            taken.push(batch.slice(0, n_here));
            if n_here < batch.num_rows() {
                self.rest = Some(batch.slice(n_here, batch.num_rows() - n_here));
            }
            n_missing -= n_here;
        }
        self.n_taken += n - n_missing;
        let Some(first) = taken.first() else { return Ok(None) };
        let together = concat_batches(&first.schema(), &taken);
        together.map(Some).map_err(|error| Error::unreadable(path, error))
    }
}
