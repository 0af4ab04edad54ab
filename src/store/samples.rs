//! Sample shards: the generated scenarios between the generate stage and the corpus.

use super::atomic::FileStamp;
use super::tables::sample;
use super::{MapSource, Result, ScenarioRecord, parquet_file};
use std::path::Path;

/// Writes one shard of generated scenarios, in the order given. Keep samples of a scene together: they share its lanes
/// when read.
///
/// # Errors
/// [`Error::Invalid`](super::Error::Invalid) when a record would not be read back as it is, for instance because its scene
/// was not passed through [`as_stored`](super::as_stored); those of the file system.
pub fn write_samples(path: &Path, records: &[ScenarioRecord]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &sample::schema(), &sample::encode(records)?)
}

/// Reads one shard of generated scenarios; lanes come from `maps`, such as the scene store they were generated from.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is no
/// such shard; those of `maps` and of the file system.
pub fn read_samples(path: &Path, maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
    let mut records = Vec::new();
    for batch in parquet_file::read(path, &sample::schema())? {
        records.extend(sample::decode(&batch, path, maps)?);
    }
    Ok(records)
}
