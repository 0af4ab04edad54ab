//! The table of recorded scenes: one row a scene, written as Arrow files that are mapped into memory.

use super::columns::Columns;
use super::{scene_derived, scene_header, scene_tracks};
use crate::scene::Scene;
use crate::store::schema::TableSchema;
use crate::store::{Error, MapSource, Result};
use arrow::array::RecordBatch;
use std::sync::Arc;

/// `scene.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = scene_header::fields();
    fields.push(scene_tracks::field());
    fields.push(scene_derived::field());
    TableSchema {
        name: "scene",
        version: 1,
        description: "One row a recorded scene, with its tracks; lanes are in the lane table.",
        fields,
        open: Vec::new(),
    }
}

/// The rows of these scenes.
pub(crate) fn encode(scenes: &[Scene]) -> Result<RecordBatch> {
    let scenes: Vec<&Scene> = scenes.iter().collect();
    let mut arrays = scene_header::encode(&scenes)?;
    arrays.push(scene_tracks::encode(&scenes)?);
    arrays.push(scene_derived::encode(&scenes)?);
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("scenes", error.to_string()))
}

/// The scene in a row, with its lanes from `maps`.
pub(crate) fn decode(columns: &Columns<'_>, row: usize, maps: &dyn MapSource) -> Result<Scene> {
    let header = scene_header::decode(columns, row)?;
    let mut tracks = scene_tracks::decode(columns, row, header.scene.n_timesteps)?;
    scene_derived::decode(columns, row, &mut tracks)?;
    let lanes = header.lanes(maps, columns.path)?;
    header.complete(columns.path, tracks, Arc::new(lanes))
}
