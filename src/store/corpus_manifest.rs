//! What a corpus says of itself: its tables, their sizes and hashes, and under which terms its sources came.

use super::atomic::{FileStamp, read_json};
use super::scene_manifest::MANIFEST_FILE;
use super::{Error, Result};
use crate::scene::Dataset;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Form of the manifest itself.
const CORPUS_SCHEMA: &str = "corpus.v1";

/// What a corpus says of itself beyond its tables.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CorpusNotes {
    /// Dataset → its license and citation. Datasets that are used and not named here get [`source_terms`].
    pub sources: BTreeMap<String, String>,
    /// Anything else, such as the pipeline's name.
    pub notes: BTreeMap<String, String>,
    /// Sweep → why samples of it are not in the corpus → how many, each for its first reason.
    pub left_out: BTreeMap<String, BTreeMap<String, u64>>,
}

/// One table of a corpus.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TableEntry {
    /// Its schema, such as `scenario.v4`.
    pub schema: String,
    /// Number of rows.
    pub n_rows: u64,
    /// Size and hash.
    pub stamp: FileStamp,
}

/// The manifest of a corpus.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CorpusManifest {
    /// Form of the manifest.
    pub schema: String,
    /// Number of scenarios.
    pub n_scenarios: u64,
    /// How many of them are verified.
    pub n_verified: u64,
    /// Number of scenarios by dataset.
    pub scenarios_by_dataset: BTreeMap<String, u64>,
    /// Number of scenarios by sweep.
    pub scenarios_by_sweep: BTreeMap<String, u64>,
    /// Number of maps.
    pub n_maps: u64,
    /// The tables, by file name.
    pub tables: BTreeMap<String, TableEntry>,
    /// License and citation of each dataset that is used.
    pub sources: BTreeMap<String, String>,
    /// What else the writer was told.
    pub notes: BTreeMap<String, String>,
    /// Sweep → why samples of it are not in the corpus → how many, each for its first reason.
    #[serde(default)]
    pub left_out: BTreeMap<String, BTreeMap<String, u64>>,
}

impl CorpusManifest {
    /// A manifest without content.
    pub(crate) fn empty() -> Self {
        Self {
            schema: CORPUS_SCHEMA.to_owned(),
            n_scenarios: 0,
            n_verified: 0,
            scenarios_by_dataset: BTreeMap::new(),
            scenarios_by_sweep: BTreeMap::new(),
            n_maps: 0,
            tables: BTreeMap::new(),
            sources: BTreeMap::new(),
            notes: BTreeMap::new(),
            left_out: BTreeMap::new(),
        }
    }

    /// Reads the manifest of a corpus, without opening its tables.
    ///
    /// # Errors
    /// [`Error::Unfinished`] when there is none, [`Error::SchemaVersion`] when it is of another version.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(MANIFEST_FILE);
        if !path.is_file() {
            return Err(Error::Unfinished { dir: dir.to_owned() });
        }
        // The version first: other versions may have other fields.
        let value: Value = read_json(&path)?;
        let found = value.get("schema").and_then(Value::as_str).unwrap_or_default();
        if found != CORPUS_SCHEMA {
            let (expected, found) = (CORPUS_SCHEMA.to_owned(), found.to_owned());
            return Err(Error::SchemaVersion { path, expected, found });
        }
        serde_json::from_value(value).map_err(Error::json(&path))
    }
}

/// The terms under which a dataset is published, which hold for what is made from it.
pub const fn source_terms(dataset: Dataset) -> &'static str {
    match dataset {
        Dataset::Interaction => {
            "INTERACTION dataset (Zhan et al. 2019): non-commercial use under the terms it was obtained with. Recordings of \
             another origin in its format are under the terms of their maker."
        }
        Dataset::Argoverse1 => "Argoverse 1 (Chang et al. 2019): CC BY-NC-SA 4.0, non-commercial use only.",
        Dataset::Argoverse2 => "Argoverse 2 (Wilson et al. 2021): CC BY-NC-SA 4.0, non-commercial use only.",
    }
}
