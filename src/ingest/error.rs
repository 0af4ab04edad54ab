//! Errors that end an ingest, as opposed to rejects of single recordings.

use super::report::IngestReport;
use std::path::PathBuf;

/// An error of the caller, passed through unchanged.
pub type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// An error in the content of a file, in words that follow the file's name and the place in it.
#[derive(Debug, thiserror::Error)]
pub(super) enum Malformed {
    #[error("{0}")]
    Content(String),
    #[error(transparent)]
    Xml(#[from] quick_xml::Error),
    #[error(transparent)]
    XmlAttribute(#[from] quick_xml::events::attributes::AttrError),
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    #[error(transparent)]
    Csv(#[from] csv::Error),
    #[error(transparent)]
    Parquet(#[from] parquet::errors::ParquetError),
    #[error(transparent)]
    Arrow(#[from] arrow::error::ArrowError),
}

impl From<String> for Malformed {
    fn from(detail: String) -> Self {
        Self::Content(detail)
    }
}

impl From<&str> for Malformed {
    fn from(detail: &str) -> Self {
        Self::Content(detail.to_owned())
    }
}

/// Why an ingest cannot continue.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// The configuration contradicts itself or the dataset.
    #[error("ingest.{key}: {detail}")]
    Config { key: String, detail: String },
    /// An input that the operating system could not read; the message names the path.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// A folder, archive or compressed file cannot be read to its end.
    #[error("cannot read {}{}: {detail}", .container.display(), in_container(.file))]
    Container { container: PathBuf, file: String, detail: String },
    /// A map cannot be read.
    #[error("map {file}{}: {detail}", at_place(.place))]
    Map { file: String, place: String, detail: String },
    /// Maps are required and none was found.
    #[error(
        "no {dataset} map found among {searched}{}{}; add the map files to `ingest.map_inputs`, or set \
         `ingest.maps = \"none\"`", .needed.as_ref().map_or(String::new(), |needed| format!(", as {needed} needs")),
        passed_over_in_words(.passed_over)
    )]
    NoMaps { dataset: &'static str, searched: String, needed: Option<String>, passed_over: Vec<String> },
    /// Maps are required and some places lack one.
    #[error(
        "no map for {}: the maps found are for {}{}; add the missing ones to `ingest.map_inputs`, restrict \
         `ingest.places`, or set `ingest.maps = \"none\"`", .missing.join(", "), .found.join(", "),
        passed_over_in_words(.passed_over)
    )]
    MissingMaps { missing: Vec<String>, found: Vec<String>, passed_over: Vec<String> },
    /// Everything was read, but there are no scenes.
    #[error("no scenes: {files}; {}", .report.summary())]
    NoScenes { files: String, report: Box<IngestReport> },
    /// The receiver of the scenes failed.
    #[error("cannot store ingested scenes")]
    Sink(#[source] BoxError),
}

impl Error {
    pub(super) fn map(file: &str, place: impl Into<String>, detail: impl Into<Malformed>) -> Self {
        Self::Map { file: file.to_owned(), place: place.into(), detail: detail.into().to_string() }
    }
}

fn in_container(file: &str) -> String {
    if file.is_empty() { String::new() } else { format!(", entry {file}") }
}

fn at_place(place: &str) -> String {
    if place.is_empty() { String::new() } else { format!(", {place}") }
}

fn passed_over_in_words(archives: &[String]) -> String {
    const N_SHOWN: usize = 3;
    let shown = archives.iter().take(N_SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
    match archives.len() {
        0 => String::new(),
        n if n <= N_SHOWN => format!(", where {shown} cannot be read; unpack it"),
        n => format!(", where {n} archives cannot be read, such as {shown}; unpack them"),
    }
}
