//! Argoverse 2 recordings: from the rows of a parquet file to the tracks of a scene.

use super::RECORDED;
use crate::geometry::Vec2;
use crate::ingest::ids;
use crate::ingest::parquet_columns::{Columns, Limits};
use crate::ingest::plausible_tracks::recorded_heading;
use crate::ingest::raw::{Finding, RawScene, RawUnit, Reject, map_id};
use crate::ingest::source::Horizon;
use crate::scene::{AgentClass, Dataset, SceneId, Split, State, Track, TrackId, TrackRole, Trajectory};
use std::collections::HashMap;

const COLUMNS: [&str; 12] = [
    "track_id",
    "object_type",
    "object_category",
    "timestep",
    "position_x",
    "position_y",
    "heading",
    "velocity_x",
    "velocity_y",
    "scenario_id",
    "focal_track_id",
    "city",
];

/// The time of the first row; not every file has it as a number.
const START: &str = "start_timestamp";

const DT_S: f64 = 0.1;

/// A scenario has some hundred tracks of at most 110 rows, and its columns some hundred kilobytes.
const LIMITS: Limits = Limits { n_rows: 1 << 17, n_bytes: 64 << 20 };

/// The scene of a file, cut to `horizon` around the present of the dataset. Rows are counted from 0.
pub(super) fn parse(unit: &RawUnit, horizon: Horizon) -> Result<RawScene, Reject> {
    let table =
        Columns::read(&unit.bytes, &COLUMNS, &[START], LIMITS).map_err(|detail| unit.reject("bad_parquet", detail))?;
    let missing = table.missing(&COLUMNS);
    if !missing.is_empty() {
        return Err(unit.reject("missing_column", format!("no column {}", missing.join(", "))));
    }
    if table.n_rows() == 0 {
        return Err(unit.reject("no_rows", "the table is empty"));
    }
    let malformed = |detail| unit.reject("malformed_row", detail);
    let split = unit.split.of_scene();
    let timesteps = timesteps(unit, &table, split)?;
    let first = RECORDED.n_history - horizon.n_history;
    let last = timesteps.n_recorded.min(RECORDED.n_history + horizon.n_future);

    let (mut tracks, mut findings) = read_tracks(unit, &table, &timesteps)?;
    for track in &mut tracks {
        track.trajectory = Trajectory::new(track.trajectory.entries()[first..last].to_vec());
    }
    match tracks.iter().find(|track| track.role == TrackRole::Focal) {
        None => return Err(unit.reject("no_focal_track", "no track is named by focal_track_id")),
        Some(focal) if focal.class == AgentClass::Unknown => {
            return Err(unit.reject("unknown_agent_type", format!("track {}, the focal one, is of no type", focal.id)));
        }
        Some(_) => {}
    }
    let case_id = table.text("scenario_id").map_err(malformed)?.value(0).to_owned();
    let place = table.text("city").map_err(malformed)?.value(0).to_owned();
    if place.trim().is_empty() {
        let detail = format!("{}: column city is blank, so that its place has no name", unit.file);
        findings.push(Finding { what: "scenarios_without_city", n: 1, detail });
    }
    Ok(RawScene {
        id: SceneId(format!("{}/{}/{place}/{case_id}", Dataset::Argoverse2.name(), split.name())),
        map_id: map_id(Dataset::Argoverse2, &case_id),
        source: unit.source(Dataset::Argoverse2, split, place, case_id, first_frame(&table, first)),
        dt_s: DT_S,
        n_timesteps: last - first,
        n_history: horizon.n_history,
        tracks,
        heading_gaps: Vec::new(),
        own_map: None,
        findings,
    })
}

/// The time of timestep `first` in nanoseconds; without `start_timestamp`, the timestep itself.
fn first_frame(table: &Columns, first: usize) -> String {
    const DT_NS: i64 = 100_000_000;
    match table.integer(START) {
        Ok(start_ns) => start_ns.value(0).saturating_add(first as i64 * DT_NS).to_string(),
        Err(_) => first.to_string(),
    }
}

struct Timesteps {
    of_row: Vec<usize>,
    n_recorded: usize,
}

/// The timestep of each row, and the number of timesteps: all, or (not in train and val) those up to the present.
fn timesteps(unit: &RawUnit, table: &Columns, split: Split) -> Result<Timesteps, Reject> {
    let column = table.integer("timestep").map_err(|detail| unit.reject("malformed_row", detail))?;
    let mut of_row = Vec::with_capacity(column.len());
    let mut is_used = vec![false; RECORDED.n_timesteps()];
    for (row, value) in column.values().iter().enumerate() {
        let timestep = usize::try_from(*value).ok().filter(|timestep| *timestep < is_used.len());
        let Some(timestep) = timestep else {
            let detail = format!("row {row}: timestep is {value}, expected 0 to {}", is_used.len() - 1);
            return Err(unit.reject("malformed_row", detail));
        };
        is_used[timestep] = true;
        of_row.push(timestep);
    }
    let n_used = is_used.iter().filter(|used| **used).count();
    let n_recorded = is_used.iter().rposition(|used| *used).map_or(0, |last| last + 1);
    let is_whole = n_used == RECORDED.n_timesteps();
    let ends_at_present = n_used == RECORDED.n_history && n_recorded == RECORDED.n_history;
    if is_whole || (ends_at_present && matches!(split, Split::Test | Split::Unsplit)) {
        return Ok(Timesteps { of_row, n_recorded });
    }
    let detail = format!("{n_used} distinct timesteps up to {n_recorded}, expected {}", RECORDED.n_timesteps());
    Err(unit.reject("wrong_timestamp_count", detail))
}

fn read_tracks(unit: &RawUnit, table: &Columns, timesteps: &Timesteps) -> Result<(Vec<Track>, Vec<Finding>), Reject> {
    let malformed = |detail| unit.reject("malformed_row", detail);
    let float = |name| table.float(name).map_err(malformed);
    let text = |name| table.text(name).map_err(malformed);
    let (ids, types, focal) = (text("track_id")?, text("object_type")?, text("focal_track_id")?);
    let categories = table.integer("object_category").map_err(malformed)?;
    let (x, y, heading) = (float("position_x")?, float("position_y")?, float("heading")?);
    let (velocity_x, velocity_y) = (float("velocity_x")?, float("velocity_y")?);

    let mut heads: Vec<(TrackId, AgentClass, TrackRole)> = Vec::new();
    let mut states: Vec<Vec<Option<State>>> = Vec::new();
    let mut known: HashMap<&str, usize> = HashMap::new();
    let mut unlisted: Option<(u64, String)> = None;
    for (row, &timestep) in timesteps.of_row.iter().enumerate() {
        let id = ids.value(row);
        let track_idx = *known.entry(id).or_insert_with(|| {
            let role = role_of(id, categories.value(row), focal.value(row));
            let class = class_of(types.value(row)).unwrap_or_else(|| {
                unlisted.get_or_insert_with(|| (0, types.value(row).to_owned())).0 += 1;
                AgentClass::Unknown
            });
            heads.push((TrackId::from(id), class, role));
            states.push(vec![None; timesteps.n_recorded]);
            heads.len() - 1
        });
        let state = State {
            position: Vec2::new(x.value(row), y.value(row)),
            heading_rad: recorded_heading(heading.value(row), heads[track_idx].1),
            velocity: Vec2::new(velocity_x.value(row), velocity_y.value(row)),
        };
        if !state.is_finite() {
            return Err(unit.reject("non_finite", format!("row {row}: state of track {id} at timestep {timestep}")));
        }
        if states[track_idx][timestep].replace(state).is_some() {
            let detail = format!("row {row}: track {id} has a second row at timestep {timestep}");
            return Err(unit.reject("duplicate_frame", detail));
        }
    }
    if let Some(pair) = ids::ambiguous(heads.iter().map(|(id, ..)| id.0.as_bytes())).next() {
        return Err(unit.reject(ids::AMBIGUOUS, ids::in_words("track", pair)));
    }
    let tracks = heads.into_iter().zip(states).map(|((id, class, role), states)| Track {
        id,
        class,
        role,
        extent: None,
        trajectory: Trajectory::new(states),
    });
    let findings = unlisted.map(|(n, first)| Finding {
        what: "tracks_of_unlisted_types",
        n,
        detail: format!("{}: object_type {first:?}; they are left out", unit.file),
    });
    Ok((tracks.collect(), findings.into_iter().collect()))
}

/// `object_category`: 0 track fragment, 1 unscored, 2 scored, 3 focal.
fn role_of(track_id: &str, category: i64, focal_track_id: &str) -> TrackRole {
    match (track_id, category) {
        _ if track_id == focal_track_id => TrackRole::Focal,
        ("AV", _) => TrackRole::Recorder,
        (_, 2 | 3) => TrackRole::Scored,
        _ => TrackRole::Context,
    }
}

/// The class of a type, in any case; `None` if the format does not list it.
fn class_of(object_type: &str) -> Option<AgentClass> {
    let class = match object_type.to_ascii_lowercase().as_str() {
        "vehicle" => AgentClass::Vehicle,
        "bus" => AgentClass::Bus,
        "motorcyclist" => AgentClass::Motorcyclist,
        "cyclist" => AgentClass::Cyclist,
        "pedestrian" => AgentClass::Pedestrian,
        "static" | "background" | "construction" | "riderless_bicycle" => AgentClass::Static,
        "unknown" => AgentClass::Unknown,
        _ => return None,
    };
    Some(class)
}

#[cfg(test)]
pub(super) mod tests;
