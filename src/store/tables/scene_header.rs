//! The columns of a scene apart from its tracks; scenes, sample shards and scenario tables share them.

use super::columns::{Columns, number_lists, numbers, optional_texts, small, structs, texts};
use crate::geometry::{Transform2, Vec2};
use crate::scene::{
    Dataset, LaneGraph, LaneId, MapId, Scene, SceneId, SceneSource, SituationKind, Split, Track, TrackId,
};
use crate::store::schema::{ColumnExt, WORLD_FRAME, column, list_of};
use crate::store::{Error, MapSource, Result};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, Float64Type, Int64Type, UInt32Type};
use std::path::Path;
use std::sync::Arc;

/// The column of the track around which the scene was cut out.
const CENTER: &str = "center_track_id";

/// The columns, in order.
pub(crate) fn fields() -> Vec<Field> {
    vec![
        column("scene_id", DataType::Utf8, "The scene whose past it is: dataset/split/place/case."),
        column("dataset", DataType::Utf8, "Dataset of the recording."),
        column("version", DataType::Utf8, "Version or layout of the dataset; empty if there is only one."),
        column("split", DataType::Utf8, "Split of the dataset: train, val, test or unsplit."),
        column("place", DataType::Utf8, "City or location, as the dataset names it."),
        column("file", DataType::Utf8, "Recording file within its folder or archive."),
        column("case_id", DataType::Utf8, "Case, sequence or scenario id within the file, as written."),
        column(
            "first_frame",
            DataType::Utf8,
            "First frame or timestamp as written; of tables, time in steps of 0.1 s.",
        ),
        column(
            "situation",
            DataType::Utf8,
            "How the past came about: recorded, continued (a closed loop led to it from a recorded scene) or populated \
             (from one into which road users were put).",
        ),
        column(
            "continues",
            DataType::Utf8,
            "The recorded scene from which a closed loop led to it; missing if recorded.",
        )
        .optional(),
        column("dt_s", DataType::Float64, "Time between timesteps.").unit("s"),
        column("n_timesteps", DataType::UInt32, "Number of timesteps, history and future.").unit("1"),
        column("n_history", DataType::UInt32, "Number of observed timesteps; the present is n_history - 1.").unit("1"),
        column(
            "world_from_scene",
            DataType::Struct(transform_fields().into()),
            "Transforms scene coordinates to the recording: rotate, then translate.",
        )
        .frame(WORLD_FRAME),
        column(
            CENTER,
            DataType::Utf8,
            "The track around which the scene was cut out; its present state defines the scene frame.",
        ),
        column("map_id", DataType::Utf8, "Map of the lanes; missing if the dataset was ingested without maps.")
            .optional(),
        column(
            "lane_ids",
            list_of(DataType::Int64),
            "Lanes near the scene, ascending; their rows are in the lane table.",
        ),
    ]
}

fn transform_fields() -> Vec<Field> {
    vec![
        column("x_m", DataType::Float64, "Origin of the scene frame.").unit("m").frame(WORLD_FRAME),
        column("y_m", DataType::Float64, "Origin of the scene frame.").unit("m").frame(WORLD_FRAME),
        column("rotation_rad", DataType::Float64, "Direction of the scene's x axis.").unit("rad").frame(WORLD_FRAME),
    ]
}

/// The arrays of these scenes, in the order of [`fields`].
pub(crate) fn encode(scenes: &[&Scene]) -> Result<Vec<ArrayRef>> {
    let (mut n_timesteps, mut n_history) = (Vec::new(), Vec::new());
    for scene in scenes {
        n_timesteps.push(small(&scene.id.0, "number of timesteps", scene.n_timesteps)?);
        n_history.push(small(&scene.id.0, "number of observed timesteps", scene.n_history)?);
        check(scene)?;
    }
    let world_from_scene = |number: fn(&Transform2) -> f64| {
        numbers::<Float64Type>(scenes.iter().map(|scene| number(&scene.world_from_scene)))
    };
    let transform = structs(
        "scene",
        &DataType::Struct(transform_fields().into()),
        vec![
            world_from_scene(|t| t.translation.x),
            world_from_scene(|t| t.translation.y),
            world_from_scene(Transform2::rotation_rad),
        ],
    )?;
    let source = |text: fn(&SceneSource) -> &str| texts(scenes.iter().map(|scene| text(&scene.source)));
    Ok(vec![
        texts(scenes.iter().map(|scene| scene.id.0.as_str())),
        source(|s| s.dataset.name()),
        source(|s| &s.version),
        source(|s| s.split.name()),
        source(|s| &s.place),
        source(|s| &s.file),
        source(|s| &s.case_id),
        source(|s| &s.first_frame),
        source(|s| s.situation.name()),
        optional_texts(scenes.iter().map(|scene| scene.source.continues.as_ref().map(|id| id.0.as_str()))),
        numbers::<Float64Type>(scenes.iter().map(|scene| scene.dt_s)),
        numbers::<UInt32Type>(n_timesteps),
        numbers::<UInt32Type>(n_history),
        transform,
        texts(scenes.iter().map(|scene| scene.ego().id.0.as_str())),
        optional_texts(scenes.iter().map(|scene| scene.map_id.as_ref().map(|id| id.0.as_str()))),
        number_lists::<Int64Type, _>(scenes.iter().map(|scene| scene.lanes.lanes().iter().map(|lane| lane.id.0))),
    ])
}

/// Rejects scenes that a header cannot hold.
fn check(scene: &Scene) -> Result<()> {
    let refuse = |detail: &str| Err(Error::invalid(&scene.id, detail));
    if scene.ego_idx >= scene.tracks.len() {
        return refuse("its center is not among its tracks");
    }
    if scene.map_id.is_none() && !scene.lanes.is_empty() {
        return refuse("it has lanes but names no map");
    }
    let t = &scene.world_from_scene;
    if !(scene.dt_s.is_finite() && t.translation.is_finite() && t.rotation_rad().is_finite()) {
        return refuse("its timing or frame is not finite");
    }
    Ok(())
}

/// A scene without tracks and lanes, and the keys to find them.
pub(crate) struct SceneHeader {
    /// The scene without tracks, center and lanes.
    pub(crate) scene: Scene,
    /// The track around which the scene was cut out.
    pub(crate) center_track_id: TrackId,
    /// The lanes, to be found in the map.
    pub(crate) lane_ids: Vec<LaneId>,
}

pub(crate) fn decode(columns: &Columns<'_>, row: usize) -> Result<SceneHeader> {
    let text = |name: &str| columns.text(name, row).map(str::to_owned);
    let transform = columns.of_struct_column("world_from_scene")?;
    let coordinate = |name: &str| transform.number::<Float64Type>(name, row);
    let scene = Scene {
        id: SceneId(text("scene_id")?),
        source: SceneSource {
            dataset: columns.named("dataset", row, Dataset::from_name)?,
            version: text("version")?,
            split: columns.named("split", row, Split::from_name)?,
            place: text("place")?,
            file: text("file")?,
            case_id: text("case_id")?,
            first_frame: text("first_frame")?,
            situation: columns.named("situation", row, SituationKind::from_name)?,
            continues: columns.optional_text("continues", row)?.map(SceneId::from),
        },
        dt_s: columns.number::<Float64Type>("dt_s", row)?,
        n_timesteps: columns.number::<UInt32Type>("n_timesteps", row)? as usize,
        n_history: columns.number::<UInt32Type>("n_history", row)? as usize,
        world_from_scene: Transform2::from_pose(
            Vec2::new(coordinate("x_m")?, coordinate("y_m")?),
            coordinate("rotation_rad")?,
        ),
        ego_idx: 0,
        tracks: Vec::new(),
        map_id: columns.optional_text("map_id", row)?.map(MapId::from),
        lanes: Arc::default(),
    };
    let lane_ids = columns.numbers::<Int64Type>("lane_ids", row)?.iter().copied().map(LaneId).collect();
    Ok(SceneHeader { scene, center_track_id: TrackId(text(CENTER)?), lane_ids })
}

impl SceneHeader {
    /// The lanes of the scene, in the scene frame.
    pub(crate) fn lanes(&self, maps: &dyn MapSource, path: &Path) -> Result<LaneGraph> {
        if self.lane_ids.is_empty() {
            return Ok(LaneGraph::default());
        }
        let map_id = self.scene.map_id.as_ref().ok_or_else(|| Error::corrupt(path, "a scene has lanes but no map"))?;
        let lanes = maps.lanes(map_id, &self.lane_ids)?;
        Ok(lanes.into_frame(&self.scene.world_from_scene.inverse()))
    }

    /// The scene with its tracks and lanes, both in the scene frame.
    pub(crate) fn complete(self, path: &Path, tracks: Vec<Track>, lanes: Arc<LaneGraph>) -> Result<Scene> {
        let ego_idx = tracks.iter().position(|track| track.id == self.center_track_id).ok_or_else(|| {
            Error::corrupt(
                path,
                format!("the center {} of {} is not among its tracks", self.center_track_id, self.scene.id),
            )
        })?;
        Ok(Scene { ego_idx, tracks, lanes, ..self.scene })
    }
}
