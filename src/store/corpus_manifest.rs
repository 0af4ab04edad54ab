//! The manifest of a corpus: its tables with sizes and hashes, its counts, and the terms of its sources.

use super::atomic::read_json;
use super::corpus_layout::{CorpusTable, Partition};
use super::scene_manifest::MANIFEST_FILE;
use super::{Error, Result};
use crate::files::FileStamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Version of the manifest and the folder: tables in partitions.
pub(crate) const CORPUS_SCHEMA: &str = "corpus.v1";

/// Notes of the writer in the manifest.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CorpusNotes {
    /// Dataset → its license and citation. Datasets without an entry get [their own
    /// terms](crate::scene::DatasetFacts::terms).
    pub sources: BTreeMap<String, String>,
    /// Anything else, such as the pipeline's name.
    pub notes: BTreeMap<String, String>,
    /// Sweep → reason why samples are not in the corpus → their number; each sample counts for its first reason.
    pub left_out: BTreeMap<String, BTreeMap<String, u64>>,
}

/// One file of a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Its path in the corpus, with `/` between folders.
    pub path: String,
    /// The values that all of its rows share.
    pub partition: Partition,
    /// Number of rows.
    pub n_rows: u64,
    /// Size and hash.
    pub stamp: FileStamp,
}

/// One table of a corpus.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TableEntry {
    /// Its schema, such as `scenario.v1`.
    pub schema: String,
    /// Number of rows in all of its files.
    pub n_rows: u64,
    /// Size of all of its files.
    pub n_bytes: u64,
    /// The columns in the names of its folders, outermost first; empty for a single file.
    pub partitioned_by: Vec<String>,
    /// Its files, in the order of their partitions.
    pub files: Vec<FileEntry>,
}

/// The number of scenarios of a behavior at a place.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartitionCount {
    /// The requested behavior, or `none`.
    pub behavior: String,
    /// The place.
    pub place: String,
    /// Number of scenarios.
    pub n_scenarios: u64,
    /// The number of verified ones.
    pub n_verified: u64,
    /// The number of verified ones whose recording does not already show the behavior.
    pub n_new: u64,
}

/// The manifest of a corpus.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CorpusManifest {
    /// Version of the manifest.
    pub schema: String,
    /// Number of scenarios.
    pub n_scenarios: u64,
    /// The number of verified ones.
    pub n_verified: u64,
    /// The number of verified ones whose recording does not already show the behavior.
    pub n_new: u64,
    /// Number of recorded scenes that the scenarios continue and whose tracks are in the corpus.
    pub n_recordings: u64,
    /// Number of maps.
    pub n_maps: u64,
    /// Number of scenarios by dataset.
    pub scenarios_by_dataset: BTreeMap<String, u64>,
    /// Number of scenarios by sweep.
    pub scenarios_by_sweep: BTreeMap<String, u64>,
    /// Number of scenarios by behavior and place, sorted.
    pub scenarios_by_partition: Vec<PartitionCount>,
    /// The tables, by name.
    pub tables: BTreeMap<String, TableEntry>,
    /// License and citation of each dataset in the corpus.
    pub sources: BTreeMap<String, String>,
    /// Other notes of the writer.
    pub notes: BTreeMap<String, String>,
    /// Changes by tools since a pipeline wrote it, one line each.
    pub history: Vec<String>,
    /// Sweep → reason why samples are not in the corpus → their number; each sample counts for its first reason.
    pub left_out: BTreeMap<String, BTreeMap<String, u64>>,
}

/// The note that names the sweeps whose samples aim at hard events.
pub(crate) const AIMS_AT_HARD_EVENTS: &str = "aims_at_hard_events";

impl CorpusManifest {
    /// Whether the samples of a sweep aim at hard events, so that they are no sample of the events that happen.
    pub(crate) fn aims_at_hard_events(&self, sweep: &str) -> bool {
        self.notes.get(AIMS_AT_HARD_EVENTS).is_some_and(|sweeps| sweeps.split(", ").any(|name| name == sweep))
    }

    /// A manifest without content.
    pub(crate) fn empty() -> Self {
        Self {
            schema: CORPUS_SCHEMA.to_owned(),
            n_scenarios: 0,
            n_verified: 0,
            n_new: 0,
            n_recordings: 0,
            n_maps: 0,
            scenarios_by_dataset: BTreeMap::new(),
            scenarios_by_sweep: BTreeMap::new(),
            scenarios_by_partition: Vec::new(),
            tables: BTreeMap::new(),
            sources: BTreeMap::new(),
            notes: BTreeMap::new(),
            history: Vec::new(),
            left_out: BTreeMap::new(),
        }
    }

    /// Reads the manifest of a corpus, without opening its tables.
    ///
    /// # Errors
    /// [`Error::NoCorpus`] when the folder is not a corpus, [`Error::Unfinished`] when its writer did not finish,
    /// [`Error::SchemaVersion`] when the version of the manifest cannot be read.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(MANIFEST_FILE);
        // A folder that does not exist has an error of its own.
        fs_err::metadata(dir)?;
        if !path.is_file() {
            return Err(if is_begun(dir) { Error::Unfinished { dir: dir.to_owned() } } else { no_corpus(dir) });
        }
        // The version first: other versions may have other fields.
        let value: Value = read_json(&path)?;
        match value.get("schema").and_then(Value::as_str).unwrap_or_default() {
            CORPUS_SCHEMA => serde_json::from_value(value).map_err(Error::json(&path)),
            "" => Err(no_corpus(dir)),
            found => {
                let (expected, found) = (CORPUS_SCHEMA.to_owned(), found.to_owned());
                Err(Error::SchemaVersion { path, expected, found })
            }
        }
    }

    /// The files of a table; none if the corpus has no such table.
    pub fn files(&self, table: CorpusTable) -> &[FileEntry] {
        self.tables.get(table.name()).map_or(&[], |entry| &entry.files)
    }

    /// Every file of every table.
    pub fn all_files(&self) -> impl Iterator<Item = &FileEntry> {
        self.tables.values().flat_map(|entry| &entry.files)
    }

    /// Size of all tables, bytes.
    pub fn n_bytes(&self) -> u64 {
        self.tables.values().map(|entry| entry.n_bytes).sum()
    }

    /// Whether a source forbids commercial use.
    pub fn is_non_commercial(&self) -> bool {
        self.sources.values().any(|terms| terms.to_lowercase().contains("non-commercial"))
    }
}

/// Whether a corpus was begun here: whether there is a partition of a table. Files and folders called `metrics` or
/// `lanes` do not count: run folders and other programs have them, too.
fn is_begun(dir: &Path) -> bool {
    CorpusTable::ALL.into_iter().any(|table| {
        let Some(key) = table.keys().first() else { return false };
        let is_partition = |name: &str| name.split_once('=').is_some_and(|(found, _)| found == *key);
        let entries = fs_err::read_dir(dir.join(table.name())).into_iter().flatten().flatten();
        entries.into_iter().any(|entry| is_partition(&entry.file_name().to_string_lossy()))
    })
}

/// The error for a folder that is not a corpus. It names a corpus inside the folder if there is one, as in run folders.
fn no_corpus(dir: &Path) -> Error {
    let inside = Some(dir.join("corpus")).filter(|inside: &PathBuf| inside.join(MANIFEST_FILE).is_file());
    Error::NoCorpus { dir: dir.to_owned(), inside }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_a_writer_of_corpora_left_is_called_unfinished() {
        let dir = tempfile::tempdir().unwrap();
        let why = || CorpusManifest::read(dir.path()).unwrap_err();
        let make = |folder: &str| fs_err::create_dir_all(dir.path().join(folder)).unwrap();
        // A run folder has a table of metrics, and other programs may use these folder names.
        make("metrics");
        make("tracks/monday");
        fs_err::write(dir.path().join("metrics.parquet"), "").unwrap();
        fs_err::write(dir.path().join("lanes.parquet"), "").unwrap();
        assert!(matches!(why(), Error::NoCorpus { inside: None, .. }), "{}", why());
        make("corpus");
        fs_err::write(dir.path().join("corpus/manifest.json"), "{}").unwrap();
        let told = why().to_string();
        let inside = dir.path().join("corpus");
        assert!(told.ends_with(&format!("the corpus in it is {}", inside.display())), "{told}");
        make("tracks/behavior=cut_in");
        assert!(matches!(why(), Error::Unfinished { .. }));
    }
}
