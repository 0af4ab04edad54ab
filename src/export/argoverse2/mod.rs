//! Argoverse 2 motion forecasting: a Parquet table and a map in JSON for each scenario.

#[cfg(test)]
mod tests;

use super::lane_bounds::LaneBounds;
use super::{Error, ExportOutcome, Exporter, Item, Result, Written};
use crate::geometry::Vec2;
use crate::scene::{AgentClass, Lane, LaneGraph, State, TrackRole};
use crate::store::{AtomicFile, write_atomically};
use arrow::array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use parquet::file::properties::WriterProperties;
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub(super) const NOTES: &str = "<split>/<id>/scenario_<id>.parquet and log_map_archive_<id>.json, with the columns of \
    Argoverse 2; the focal track is the ego. Scenarios have as many timesteps as they have: those of other datasets \
    are not 110 long, which the av2 package reads and models for Argoverse 2 may not expect. Maps hold the lanes near \
    the scenario, without heights and crossings; drivable areas are the lanes, one area each, so that shoulders and \
    parking lots are not in them.";

/// Kinds of lanes in the format; others become `VEHICLE`.
const LANE_TYPES: [&str; 3] = ["VEHICLE", "BIKE", "BUS"];
/// Kinds of marks in the format; others become `UNKNOWN`.
const MARK_TYPES: [&str; 15] = [
    "DASH_SOLID_YELLOW",
    "DASH_SOLID_WHITE",
    "DASHED_WHITE",
    "DASHED_YELLOW",
    "DOUBLE_SOLID_YELLOW",
    "DOUBLE_SOLID_WHITE",
    "DOUBLE_DASH_YELLOW",
    "DOUBLE_DASH_WHITE",
    "SOLID_YELLOW",
    "SOLID_WHITE",
    "SOLID_DASH_WHITE",
    "SOLID_DASH_YELLOW",
    "SOLID_BLUE",
    "NONE",
    "UNKNOWN",
];

/// Writes a folder for each scenario.
pub(super) struct Argoverse2 {
    dir: PathBuf,
}

impl Argoverse2 {
    pub(super) fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned() }
    }
}

impl Exporter for Argoverse2 {
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome> {
        let scene = item.scene();
        if item.ego().trajectory.n_valid() == 0 {
            return Ok(ExportOutcome::LeftOut("no_ego"));
        }
        let id = &item.stem;
        let folder = format!("{}/{id}", scene.source.split.name());
        fs_err::create_dir_all(self.dir.join(&folder))?;
        let map = scene.lanes.transformed(&scene.world_from_scene);
        let (lanes, areas, assumed) = lanes_and_areas(&map);
        let json = json!({ "drivable_areas": areas, "lane_segments": lanes, "pedestrian_crossings": {} });
        let map_path = self.dir.join(&folder).join(format!("log_map_archive_{id}.json"));
        write_atomically::<Error>(&map_path, |file| {
            file.write_all(&serde_json::to_vec(&json).map_err(Error::encode(&map_path))?)?;
            Ok(())
        })?;
        let path = self.dir.join(&folder).join(format!("scenario_{id}.parquet"));
        write_parquet(&path, &rows(item)?)?;
        let name = |track: &crate::scene::Track| {
            if track.trajectory.n_valid() == 0 { Err("no_states") } else { Ok(track.id.0.clone()) }
        };
        let tracks = scene.tracks.iter().map(name).collect();
        Ok(ExportOutcome::Written(Written { file: folder, name: id.clone(), first_timestep: 0, tracks, assumed }))
    }
}

/// The table of a scenario.
fn rows(item: &Item<'_>) -> Result<RecordBatch> {
    let scene = item.scene();
    let states: Vec<(usize, usize, State)> = (0..scene.tracks.len())
        .flat_map(|agent_idx| {
            let entries = item.world_states(agent_idx).into_iter().enumerate();
            entries.filter_map(move |(timestep, state)| Some((agent_idx, timestep, state?)))
        })
        .collect();
    let texts = |of: &dyn Fn(usize) -> String| -> ArrayRef {
        Arc::new(StringArray::from_iter_values(states.iter().map(|(agent_idx, ..)| of(*agent_idx))))
    };
    let integers = |of: &dyn Fn(usize, usize) -> i64| -> ArrayRef {
        Arc::new(Int64Array::from_iter_values(states.iter().map(|(agent_idx, timestep, _)| of(*agent_idx, *timestep))))
    };
    let floats = |of: &dyn Fn(&State) -> f64| -> ArrayRef {
        Arc::new(Float64Array::from_iter_values(states.iter().map(|(.., state)| of(state))))
    };
    let observed: BooleanArray = states.iter().map(|(_, timestep, _)| Some(*timestep < scene.n_history)).collect();
    // The format has nanoseconds as floats; scenes without a start time begin at 0.
    let begins_at_ns = scene.source.dataset.facts().begins_at_ns;
    let start_ns = scene.source.first_frame.parse::<f64>().ok().filter(|_| begins_at_ns).unwrap_or_default();
    let end_ns = start_ns + scene.n_timesteps.saturating_sub(1) as f64 * scene.dt_s * 1e9;
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("observed", Arc::new(observed)),
        ("track_id", texts(&|agent_idx| scene.tracks[agent_idx].id.0.clone())),
        ("object_type", texts(&|agent_idx| object_type(scene.tracks[agent_idx].class).to_owned())),
        ("object_category", integers(&|agent_idx, _| category(item, agent_idx))),
        ("timestep", integers(&|_, timestep| timestep as i64)),
        ("position_x", floats(&|state| state.position.x)),
        ("position_y", floats(&|state| state.position.y)),
        ("heading", floats(&|state| state.heading_rad)),
        ("velocity_x", floats(&|state| state.velocity.x)),
        ("velocity_y", floats(&|state| state.velocity.y)),
        ("scenario_id", texts(&|_| item.stem.clone())),
        ("start_timestamp", floats(&|_| start_ns)),
        ("end_timestamp", floats(&|_| end_ns)),
        ("num_timestamps", integers(&|_, _| scene.n_timesteps as i64)),
        ("focal_track_id", texts(&|_| item.ego().id.0.clone())),
        ("city", texts(&|_| scene.source.place.clone())),
    ];
    RecordBatch::try_from_iter(columns).map_err(Error::encode(Path::new(&item.stem)))
}

/// The dataset's name for a class of road users.
const fn object_type(class: AgentClass) -> &'static str {
    match class {
        AgentClass::Vehicle => "vehicle",
        AgentClass::Bus => "bus",
        AgentClass::Motorcyclist => "motorcyclist",
        AgentClass::Cyclist => "cyclist",
        AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist => "pedestrian",
        AgentClass::Static => "static",
        AgentClass::Unknown => "unknown",
    }
}

/// 3 for the ego; 2 for agents that the recording marks or that take part in the event; 1 for others; 0 for agents that
/// are not tracked at present.
fn category(item: &Item<'_>, agent_idx: usize) -> i64 {
    let scene = item.scene();
    let is_marked = matches!(scene.tracks[agent_idx].role, TrackRole::Focal | TrackRole::Scored);
    if agent_idx == item.ego_idx {
        3
    } else if is_marked || item.event_role(agent_idx).is_some() {
        2
    } else {
        i64::from(scene.state(agent_idx, scene.current_timestep()).is_some())
    }
}

/// Counts of assumptions about a map, by code.
type Assumed = Vec<(&'static str, u64)>;

/// The lanes and the areas that they cover, both by the lanes' ids, and the assumptions about them.
fn lanes_and_areas(map: &LaneGraph) -> (Map<String, Value>, Map<String, Value>, Assumed) {
    let (mut n_nominal, mut n_left_out) = (0, 0);
    let (mut segments, mut areas) = (Map::new(), Map::new());
    for lane in map.lanes() {
        match LaneBounds::of(lane) {
            Some(bounds) => {
                n_nominal += u64::from(bounds.is_nominal);
                segments.insert(lane.id.0.to_string(), lane_segment(lane, &bounds));
                let outline: Vec<Vec2> = bounds.left.0.iter().chain(bounds.right.0.iter().rev()).copied().collect();
                areas.insert(lane.id.0.to_string(), json!({ "id": lane.id.0, "area_boundary": points(&outline) }));
            }
            None => n_left_out += 1,
        }
    }
    (segments, areas, vec![("nominal_lane_width", n_nominal), ("lane_without_extent", n_left_out)])
}

fn points(points: &[Vec2]) -> Vec<Value> {
    points.iter().map(|point| json!({ "x": rounded(point.x), "y": rounded(point.y), "z": 0.0 })).collect()
}

fn lane_segment(lane: &Lane, bounds: &LaneBounds) -> Value {
    let known = |name: &str, names: &[&'static str]| names.iter().copied().find(|known| *known == name);
    let mark = |tag: &str| lane.attributes.tags.get(tag).and_then(|mark| known(mark, &MARK_TYPES)).unwrap_or("UNKNOWN");
    let ids = |ids: &[crate::scene::LaneId]| ids.iter().map(|id| id.0).collect::<Vec<_>>();
    json!({
        "id": lane.id.0,
        "is_intersection": lane.attributes.is_intersection,
        "lane_type": known(&lane.attributes.kind, &LANE_TYPES).unwrap_or("VEHICLE"),
        "left_lane_boundary": points(&bounds.left.0),
        "left_lane_mark_type": mark("left_mark"),
        "right_lane_boundary": points(&bounds.right.0),
        "right_lane_mark_type": mark("right_mark"),
        "centerline": points(&lane.centerline.0),
        "successors": ids(&lane.successors),
        "predecessors": ids(&lane.predecessors),
        "left_neighbor_id": lane.left_neighbor.map(|id| id.0),
        "right_neighbor_id": lane.right_neighbor.map(|id| id.0),
    })
}

/// Rounded to micrometers, which makes the file shorter.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn write_parquet(path: &Path, batch: &RecordBatch) -> Result<()> {
    // Another version of the library must not change the bytes.
    let properties = WriterProperties::builder().set_created_by("djinn".to_owned()).build();
    let file = AtomicFile::create(path)?;
    let mut writer = ArrowWriter::try_new(file, batch.schema(), Some(properties)).map_err(Error::encode(path))?;
    writer.write(batch).map_err(Error::encode(path))?;
    writer.into_inner().map_err(Error::encode(path))?.commit()?;
    Ok(())
}
