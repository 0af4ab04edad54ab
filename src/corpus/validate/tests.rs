//! Is each kind of damage found, at its file and row, and nothing in a corpus that is whole?

use super::*;
use crate::corpus::testing::{records, write};
use crate::progress::Silent;
use crate::store::{CorpusManifest, CorpusTable, FileStamp, Partition, write_json_atomically};
use arrow::array::{ArrayRef, Float32Array, Float64Array, RecordBatch, StringArray, UInt32Array};
use arrow::compute::concat_batches;
use std::path::PathBuf;
use std::sync::Arc;

/// A whole corpus, to be damaged.
struct Corpus {
    _dir: tempfile::TempDir,
    path: PathBuf,
    manifest: CorpusManifest,
}

impl Corpus {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("corpus");
        let manifest = write(&path, &records(0..12));
        Self { _dir: dir, path, manifest }
    }

    fn report(&self) -> ValidationReport {
        validate(&self.path, &Silent).unwrap()
    }

    /// The largest file of a table.
    fn file(&self, table: CorpusTable) -> (usize, String) {
        let files = self.manifest.files(table).iter().enumerate();
        let (i, file) = files.max_by_key(|(_, file)| file.n_rows).unwrap();
        (i, file.path.clone())
    }

    /// Changes the rows of a file of a table and stamps it anew, as a faulty writer would have written it.
    fn rewrite(&mut self, table: CorpusTable, change: impl Fn(&RecordBatch) -> RecordBatch) -> String {
        let scan = CorpusScan::open_unverified(&self.path).unwrap();
        let (i, name) = self.file(table);
        let file = scan.manifest().files(table)[i].clone();
        let batches: Vec<RecordBatch> = scan.batches(table, &file, None).unwrap().map(|batch| batch.unwrap()).collect();
        let batch = change(&concat_batches(&batches[0].schema(), &batches).unwrap());
        crate::store::testing::write_table(&self.path.join(&name), &table.schema(), &batch);
        let entry = &mut self.manifest.tables.get_mut(table.name()).unwrap();
        entry.files[i].stamp = FileStamp::of(&fs_err::read(self.path.join(&name)).unwrap());
        let n_rows = batch.num_rows() as u64;
        entry.n_rows = entry.n_rows + n_rows - entry.files[i].n_rows;
        entry.files[i].n_rows = n_rows;
        write_json_atomically(&self.path.join("manifest.json"), &self.manifest).unwrap();
        name
    }
}

fn replaced(batch: &RecordBatch, name: &str, column: ArrayRef) -> RecordBatch {
    let i = batch.schema().index_of(name).unwrap();
    let mut columns = batch.columns().to_vec();
    columns[i] = column;
    RecordBatch::try_new(batch.schema(), columns).unwrap()
}

/// The batch with one number of a column changed.
fn with_single(batch: &RecordBatch, name: &str, row: usize, number: f32) -> RecordBatch {
    let column: &Float32Array = batch.column_by_name(name).unwrap().as_any().downcast_ref().unwrap();
    let mut numbers: Vec<Option<f32>> = column.iter().collect();
    numbers[row] = Some(number);
    replaced(batch, name, Arc::new(Float32Array::from(numbers)))
}

fn with_text(batch: &RecordBatch, name: &str, row: usize, text: &str) -> RecordBatch {
    let column: &StringArray = batch.column_by_name(name).unwrap().as_any().downcast_ref().unwrap();
    let mut texts: Vec<Option<&str>> = column.iter().collect();
    texts[row] = Some(text);
    replaced(batch, name, Arc::new(StringArray::from(texts)))
}

#[test]
fn a_whole_corpus_has_no_findings() {
    let corpus = Corpus::new();
    let report = corpus.report();
    assert_eq!(report.findings, []);
    assert_eq!(report.n_files, corpus.manifest.all_files().count() as u64);
    let n_rows = |table: &str| corpus.manifest.tables[table].n_rows;
    assert_eq!((report.n_scenarios, report.n_states), (24, n_rows("tracks") + n_rows("recordings")));
}

#[test]
fn a_wrong_row_is_found_at_its_row() {
    // Row 20 is within the first scenario: its first tracks have at least 8 states each.
    type Change = fn(&RecordBatch) -> RecordBatch;
    let cases: [(CorpusTable, &str, Option<u64>, Change); 12] = [
        (CorpusTable::Tracks, "not_a_number", Some(20), |batch| with_single(batch, "vx_mps", 20, f32::NAN)),
        (CorpusTable::Tracks, "frames", Some(20), |batch| with_single(batch, "y_m", 20, 123.0)),
        (CorpusTable::Tracks, "range", Some(20), |batch| with_single(batch, "heading_rad", 20, 3.2)),
        (CorpusTable::Tracks, "range", Some(20), |batch| with_single(batch, "length_m", 20, -1.0)),
        (CorpusTable::Tracks, "speed", Some(20), |batch| with_single(batch, "vy_mps", 20, 300.0)),
        (CorpusTable::Tracks, "reference", Some(20), |batch| with_text(batch, "scenario_id", 20, "nobody")),
        (CorpusTable::Tracks, "order", None, |batch| {
            let column: &UInt32Array = batch.column_by_name("timestep").unwrap().as_any().downcast_ref().unwrap();
            let mut timesteps: Vec<u32> = column.values().to_vec();
            timesteps.swap(0, 1);
            replaced(batch, "timestep", Arc::new(UInt32Array::from(timesteps)))
        }),
        (CorpusTable::Scenarios, "duplicate", None, |batch| {
            let column: &StringArray = batch.column_by_name("scenario_id").unwrap().as_any().downcast_ref().unwrap();
            with_text(batch, "scenario_id", 3, column.value(2))
        }),
        (CorpusTable::Scenarios, "partition", Some(2), |batch| with_text(batch, "place", 2, "elsewhere")),
        (CorpusTable::Scenarios, "reference", Some(2), |batch| with_text(batch, "map_id", 2, "terra incognita")),
        (CorpusTable::Recordings, "not_a_number", Some(5), |batch| with_single(batch, "x_m", 5, f32::INFINITY)),
        (CorpusTable::Metrics, "not_a_number", Some(1), |batch| {
            let column: &Float64Array = batch.column_by_name("value").unwrap().as_any().downcast_ref().unwrap();
            let mut values = column.values().to_vec();
            values[1] = f64::NAN;
            replaced(batch, "value", Arc::new(Float64Array::from(values)))
        }),
    ];
    for (table, check, row, change) in cases {
        let mut corpus = Corpus::new();
        let file = corpus.rewrite(table, change);
        let report = corpus.report();
        let is_it = |finding: &&Finding| {
            finding.check == check && finding.file == file && (row.is_none() || finding.row == row)
        };
        let found = report.findings.iter().find(is_it);
        assert!(found.is_some(), "{table:?} {check}: {:?}", report.findings);
        assert_eq!(found.unwrap().severity == Severity::Remark, check == "speed");
        assert!(!report.by_check.contains_key("checksum"), "{:?}", report.findings);
    }
}

/// Rewrites the scenarios of a corpus as another version of their table.
fn rewrite_scenarios(corpus: &mut Corpus, version: u32, without: &str) {
    let mut table = CorpusTable::Scenarios.schema();
    table.version = version;
    table.fields.retain(|field| field.name() != without);
    let scan = CorpusScan::open_unverified(&corpus.path).unwrap();
    let entry = corpus.manifest.tables.get_mut("scenarios").unwrap();
    entry.schema = table.id();
    for file in &mut entry.files {
        let batches = scan.batches(CorpusTable::Scenarios, file, None).unwrap();
        let batches: Vec<RecordBatch> = batches.map(|batch| batch.unwrap()).collect();
        let batch = concat_batches(&batches[0].schema(), &batches).unwrap();
        let schema = batch.schema();
        let kept: Vec<usize> = (0..schema.fields().len()).filter(|i| schema.field(*i).name() != without).collect();
        let mut batch = batch.project(&kept).unwrap();
        batch.schema_metadata_mut().clone_from(table.arrow().metadata());
        file.stamp = crate::store::testing::write_table(&corpus.path.join(&file.path), &table, &batch);
    }
    write_json_atomically(&corpus.path.join("manifest.json"), &corpus.manifest).unwrap();
}

#[test]
fn other_versions_of_a_table_and_missing_columns_are_refused() {
    use crate::store::{CorpusReader, Error};
    let version = CorpusTable::Scenarios.schema().version;
    for other in [version - 1, version + 1] {
        let mut corpus = Corpus::new();
        rewrite_scenarios(&mut corpus, other, "nothing");
        let error = CorpusReader::open(&corpus.path).err().unwrap();
        let is_told = matches!(&error, Error::SchemaVersion { found, .. } if *found == format!("scenario.v{other}"));
        assert!(is_told, "{error}");
        assert!(corpus.report().by_check.contains_key("schema"));
    }
    let mut corpus = Corpus::new();
    rewrite_scenarios(&mut corpus, version, "probability");
    let error = CorpusReader::open(&corpus.path).err().unwrap().to_string();
    assert!(error.contains("column probability is missing"), "{error}");
}

#[test]
fn rows_that_are_missing_or_too_many_are_found() {
    let mut corpus = Corpus::new();
    let file = corpus.rewrite(CorpusTable::Tracks, |batch| batch.slice(0, batch.num_rows() - 1));
    let report = corpus.report();
    assert!(
        report.findings.iter().any(|f| f.detail.contains(&file) && f.detail.contains("before the last states")),
        "{:?}",
        report.findings
    );

    let mut corpus = Corpus::new();
    corpus.rewrite(CorpusTable::Scenarios, |batch| batch.slice(0, batch.num_rows() - 1));
    let report = corpus.report();
    let has = |part: &str| report.findings.iter().any(|finding| finding.detail.contains(part));
    assert!(has("belong to no scenario") && has("n_scenarios is 24, but there are 23"), "{:?}", report.findings);
    assert!(has("there is no scenario"), "{:?}", report.findings);

    let mut corpus = Corpus::new();
    corpus.rewrite(CorpusTable::Lanes, |batch| batch.slice(0, 2));
    assert!(corpus.report().findings.iter().any(|finding| finding.detail.contains("map PIT has no lane")));
}

#[test]
fn every_flipped_byte_and_every_cut_is_found() {
    let corpus = Corpus::new();
    for table in CorpusTable::ALL {
        let path = corpus.path.join(corpus.file(table).1);
        let whole = fs_err::read(&path).unwrap();
        for at in (0..whole.len()).step_by(whole.len() / 7 + 1) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x55;
            for bytes in [&damaged[..], &whole[..at]] {
                fs_err::write(&path, bytes).unwrap();
                let report = corpus.report();
                assert!(report.by_check.contains_key("checksum"), "{} at {at}", path.display());
            }
        }
        fs_err::remove_file(&path).unwrap();
        let report = corpus.report();
        assert!(report.findings.iter().any(|finding| finding.detail.contains("the file is missing")));
        fs_err::write(&path, &whole).unwrap();
    }
    assert_eq!(corpus.report().findings, []);
}

#[test]
fn strangers_edited_cards_and_missing_recordings_are_told() {
    let corpus = Corpus::new();
    let stranger =
        CorpusTable::Tracks.file(&Partition { behavior: Some("old".to_owned()), place: Some("PIT".to_owned()) }, 0);
    fs_err::create_dir_all(corpus.path.join(&stranger).parent().unwrap()).unwrap();
    fs_err::copy(corpus.path.join("lanes.parquet"), corpus.path.join(&stranger)).unwrap();
    fs_err::write(corpus.path.join("README.md"), "mine now").unwrap();
    let report = corpus.report();
    let found: Vec<(&str, &str)> =
        report.findings.iter().map(|finding| (finding.check, finding.file.as_str())).collect();
    assert_eq!(found, [("stranger", stranger.as_str()), ("card", "README.md")]);
    assert_eq!((report.n_damages, report.n_remarks), (1, 1));
    assert!(matches!(
        validate(&corpus.path.join("tracks"), &Silent),
        Err(crate::corpus::Error::Store(crate::store::Error::NoCorpus { .. }))
    ));
}
