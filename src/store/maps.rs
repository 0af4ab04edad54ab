//! Lanes by map: the rows of each map, and the lanes of a scene among them.

use super::tables::columns::Columns;
use super::tables::lane;
use super::{Error, Result};
use crate::scene::{LaneGraph, LaneId, MapId};
use arrow::array::{Int64Array, RecordBatch, StringArray};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A source of maps: a scene store or a corpus. Lanes are in the recording's frame.
pub trait MapSource: Sync {
    /// The whole map.
    fn map(&self, id: &MapId) -> Result<LaneGraph>;

    /// These lanes of the map, with the connections among them.
    fn lanes(&self, id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph>;
}

/// Rows of lanes, and the position of each map among them.
#[derive(Debug, Default)]
pub(crate) struct MapTable {
    /// The file of the rows, for errors.
    dir: PathBuf,
    batches: Vec<(PathBuf, RecordBatch)>,
    /// The rows of each map: ranges of batches, with ascending lane ids over all of them.
    rows: BTreeMap<String, Vec<(usize, Range<usize>)>>,
    /// The maps of recent scenes: the next scene mostly has one of them.
    decoded: Mutex<BTreeMap<String, Arc<LaneGraph>>>,
}

/// Number of maps that stay decoded, and the most lanes of such a map: maps of whole cities take too much memory, and a
/// scene needs few of their lanes.
const N_DECODED: usize = 8;
const N_DECODED_LANES: usize = 2000;

impl MapTable {
    /// A table without maps.
    pub(crate) fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), ..Self::default() }
    }

    /// Adds the rows of a batch of lanes that was read from `path`.
    pub(crate) fn push(&mut self, path: &Path, batch: RecordBatch) -> Result<()> {
        let ids: &StringArray = Columns::of_batch(&batch, path).get("map_id")?;
        let batch_idx = self.batches.len();
        let mut start = 0;
        while start < batch.num_rows() {
            let id = ids.value(start);
            let end = (start + 1..batch.num_rows()).find(|row| ids.value(*row) != id).unwrap_or(batch.num_rows());
            self.rows.entry(id.to_owned()).or_default().push((batch_idx, start..end));
            start = end;
        }
        self.batches.push((path.to_owned(), batch));
        Ok(())
    }

    /// The file of the maps.
    pub(crate) fn dir(&self) -> &Path {
        &self.dir
    }

    /// The names of all maps, sorted.
    pub(crate) fn ids(&self) -> impl Iterator<Item = &str> {
        self.rows.keys().map(String::as_str)
    }

    fn rows_of(&self, id: &MapId) -> Result<&[(usize, Range<usize>)]> {
        let unknown = || Error::UnknownMap { map_id: id.0.clone(), path: self.dir.clone() };
        self.rows.get(&id.0).map(Vec::as_slice).ok_or_else(unknown)
    }

    fn columns(&self, batch_idx: usize) -> Columns<'_> {
        let (path, batch) = &self.batches[batch_idx];
        Columns::of_batch(batch, path)
    }

    /// The whole map, if it is small; decoded once for many scenes.
    fn small_map(&self, id: &MapId) -> Result<Option<Arc<LaneGraph>>> {
        let n_lanes: usize = self.rows_of(id)?.iter().map(|(_, range)| range.len()).sum();
        if n_lanes > N_DECODED_LANES {
            return Ok(None);
        }
        let lock = || self.decoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(map) = lock().get(&id.0) {
            return Ok(Some(map.clone()));
        }
        let map = Arc::new(self.map(id)?);
        let mut decoded = lock();
        if decoded.len() >= N_DECODED {
            decoded.clear();
        }
        decoded.insert(id.0.clone(), map.clone());
        Ok(Some(map))
    }

    /// The batch and row of a lane.
    fn find(&self, pieces: &[(usize, Range<usize>)], lane_id: LaneId) -> Result<Option<(usize, usize)>> {
        for (batch_idx, range) in pieces {
            let ids: &Int64Array = self.columns(*batch_idx).get("lane_id")?;
            if let Ok(i) = ids.values()[range.clone()].binary_search(&lane_id.0) {
                return Ok(Some((*batch_idx, range.start + i)));
            }
        }
        Ok(None)
    }
}

impl MapSource for MapTable {
    fn map(&self, id: &MapId) -> Result<LaneGraph> {
        let rows = self.rows_of(id)?.iter().flat_map(|(batch_idx, range)| range.clone().map(|row| (*batch_idx, row)));
        let lanes: Result<Vec<_>> = rows.map(|(batch_idx, row)| lane::decode(&self.columns(batch_idx), row)).collect();
        Ok(LaneGraph::new(lanes?))
    }

    fn lanes(&self, id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph> {
        let missing = |lane_id: &LaneId| Error::NotFound {
            path: self.dir.clone(),
            what: format!("lane {} of map {id}", lane_id.0),
        };
        if let Some(map) = self.small_map(id)? {
            let lacks = lane_ids.iter().find(|lane_id| map.get(**lane_id).is_none());
            return lacks.map_or_else(|| Ok(map.subset(lane_ids)), |lane_id| Err(missing(lane_id)));
        }
        let pieces = self.rows_of(id)?;
        let decode = |lane_id: &LaneId| {
            let (batch_idx, row) = self.find(pieces, *lane_id)?.ok_or_else(|| missing(lane_id))?;
            lane::decode(&self.columns(batch_idx), row)
        };
        let lanes: Result<Vec<_>> = lane_ids.iter().map(decode).collect();
        Ok(LaneGraph::new(lanes?))
    }
}
