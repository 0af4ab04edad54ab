//! Rows of a corpus: their columns, and their content as fingerprints.

use super::{Error, Result};
use crate::store::{self, CorpusChunk, Fingerprint, shortened};
use arrow::array::{Array, ArrayRef, RecordBatch, StringArray};
use arrow::datatypes::SchemaRef;
use arrow::row::{RowConverter, Rows, SortField};
use std::path::Path;

pub(super) fn column<'b>(batch: &'b RecordBatch, name: &str, path: &Path) -> Result<&'b ArrayRef> {
    let missing = || store::Error::corrupt(path, format!("column {name} is missing"));
    Ok(batch.column_by_name(name).ok_or_else(missing)?)
}

pub(super) fn texts<'b>(batch: &'b RecordBatch, name: &str, path: &Path) -> Result<&'b StringArray> {
    let other = || store::Error::corrupt(path, format!("column {name} does not hold text"));
    Ok(column(batch, name, path)?.as_any().downcast_ref().ok_or_else(other)?)
}

/// Turns rows of one schema into bytes that are equal for equal rows.
pub(super) struct RowBytes {
    converter: RowConverter,
}

impl RowBytes {
    pub(super) fn new(schema: &SchemaRef, path: &Path) -> Result<Self> {
        let fields = schema.fields().iter().map(|field| SortField::new(field.data_type().clone())).collect();
        Ok(Self { converter: RowConverter::new(fields).map_err(Error::arrow(path))? })
    }

    /// The bytes of all rows of `batch`.
    pub(super) fn rows(&self, batch: &RecordBatch, path: &Path) -> Result<Rows> {
        self.converter.convert_columns(batch.columns()).map_err(Error::arrow(path))
    }
}

/// The fingerprint of some rows together.
pub(super) fn of_rows(rows: &Rows, range: impl Iterator<Item = usize>) -> Fingerprint {
    let mut hasher = blake3::Hasher::new();
    add_rows(&mut hasher, rows, range);
    shortened(hasher.finalize())
}

/// Adds rows to a hash, which does not depend on the portions in which they come.
pub(super) fn add_rows(hasher: &mut blake3::Hasher, rows: &Rows, range: impl Iterator<Item = usize>) {
    for i in range {
        let row = rows.row(i);
        let bytes: &[u8] = row.as_ref();
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    }
}

/// Fingerprints of a row and of its states, which show whether two scenarios with one id are equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Content {
    pub(super) row: Fingerprint,
    pub(super) states: Fingerprint,
}

/// The content of the scenarios of a chunk whose rows were widened to one schema.
pub(super) fn contents(chunk: &CorpusChunk, wanted: impl Fn(usize) -> bool) -> Result<Vec<Option<Content>>> {
    let wanted: Vec<bool> = (0..chunk.len()).map(wanted).collect();
    if !wanted.contains(&true) {
        return Ok(vec![None; chunk.len()]);
    }
    let scenarios = RowBytes::new(&chunk.scenarios.schema(), &chunk.path)?.rows(&chunk.scenarios, &chunk.path)?;
    let tracks = RowBytes::new(&chunk.tracks.schema(), &chunk.tracks_path)?.rows(&chunk.tracks, &chunk.tracks_path)?;
    let content = |i: usize| Content {
        row: of_rows(&scenarios, i..i + 1),
        states: of_rows(&tracks, chunk.track_rows[i].clone()),
    };
    Ok(wanted.into_iter().enumerate().map(|(i, is_wanted)| is_wanted.then(|| content(i))).collect())
}
