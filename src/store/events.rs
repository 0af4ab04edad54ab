//! `events.parquet`: what did mining find?

use super::atomic::FileStamp;
use super::tables::event;
use super::{Result, parquet_file};
use crate::behavior::BehaviorEvent;
use std::path::Path;

/// Writes an event table, in the order given.
///
/// # Errors
/// [`Error::Invalid`](super::Error::Invalid) when a parameter has the name of another column; those of the file system.
pub fn write_events(path: &Path, events: &[BehaviorEvent]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &event::schema(), &event::encode(events)?)
}

/// Reads an event table, in the order it was written.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is no
/// such table; those of the file system.
pub fn read_events(path: &Path) -> Result<Vec<BehaviorEvent>> {
    let mut events = Vec::new();
    for batch in parquet_file::read(path, &event::schema())? {
        events.extend(event::decode(&batch, path)?);
    }
    Ok(events)
}
