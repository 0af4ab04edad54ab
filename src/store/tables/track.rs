//! The corpus table of tracks: one row a state of a road user, in the scene frame and in that of the recording.

use super::columns::{Columns, flags, numbers, optional_numbers, optional_texts, small, texts};
use super::scene_tracks::{extent_of, single, state_of};
use crate::scene::{AgentClass, ObservationMask, State, Track, TrackId, TrackRole, Trajectory};
use crate::store::schema::{ColumnExt, SCENE_FRAME, TableSchema, WORLD_FRAME, column};
use crate::store::{Error, Result, ScenarioRecord};
use arrow::array::{RecordBatch, StringArray};
use arrow::datatypes::{DataType, Float32Type, Float64Type, UInt32Type};
use std::collections::BTreeSet;

/// `track.v2`.
pub(crate) fn schema() -> TableSchema {
    let scene = |name: &str, unit: &str, description: &str| {
        column(name, DataType::Float32, description).unit(unit).frame(SCENE_FRAME)
    };
    let world = |name: &str, unit: &str, description: &str| {
        column(name, DataType::Float64, description).unit(unit).frame(WORLD_FRAME)
    };
    let size = |name: &str, description: &str| column(name, DataType::Float32, description).unit("m").optional();
    let fields = vec![
        column("scenario_id", DataType::Utf8, "The scenario."),
        column("track_id", DataType::Utf8, "The recording's name for the track; unique within the scenario."),
        column("class", DataType::Utf8, "Kind of road user."),
        column(
            "recorded_role",
            DataType::Utf8,
            "What the recording marks the track as: focal, scored, recorder or context.",
        ),
        column("is_ego", DataType::Boolean, "Whether it is the ego, which defines the scene frame."),
        column("event_role", DataType::Utf8, "Its role in the first requested event; missing when it has none.")
            .optional(),
        column("timestep", DataType::UInt32, "Timestep, from 0.").unit("1"),
        column("t_s", DataType::Float64, "Time since timestep 0.").unit("s"),
        column("observed", DataType::Boolean, "true: given to the denoiser, as recorded or edited; false: generated."),
        scene("x_m", "m", "Centre."),
        scene("y_m", "m", "Centre."),
        scene("heading_rad", "rad", "Direction in (-π, π]."),
        scene("vx_mps", "m/s", "Velocity."),
        scene("vy_mps", "m/s", "Velocity."),
        world("world_x_m", "m", "Centre."),
        world("world_y_m", "m", "Centre."),
        world("world_heading_rad", "rad", "Direction in (-π, π]."),
        size("length_m", "Size along the heading; missing where the recording gives none."),
        size("width_m", "Size across the heading; missing where the recording gives none."),
    ];
    TableSchema {
        name: "track",
        version: 2,
        description: "One row a state of a road user in a scenario; in the order of the scenario table, then by track, then by time.",
        fields,
        open: Vec::new(),
    }
}

/// One row of the table.
struct Row<'r> {
    record: &'r ScenarioRecord,
    agent_idx: usize,
    timestep: usize,
    state: &'r State,
}

impl<'r> Row<'r> {
    fn track(&self) -> &'r Track {
        &self.record.scenario.scene.tracks[self.agent_idx]
    }

    fn event_role(&self) -> Option<&'r str> {
        let roles = &self.record.main_event()?.roles;
        roles.iter().find(|(_, id)| *id == self.track().id).map(|(role, _)| role.as_str())
    }
}

/// The rows of these records.
pub(crate) fn encode(records: &[ScenarioRecord]) -> Result<RecordBatch> {
    let mut rows = Vec::new();
    for record in records {
        for (agent_idx, track) in record.scenario.scene.tracks.iter().enumerate() {
            let states = track.trajectory.valid();
            rows.extend(states.map(|(timestep, state)| Row { record, agent_idx, timestep, state }));
        }
    }
    let timesteps: Result<Vec<u32>> =
        rows.iter().map(|row| small(&row.record.scenario.id, "timestep", row.timestep)).collect();
    let state = |i: usize| numbers::<Float32Type>(rows.iter().map(move |row| single(row.state)[i]));
    let world = |number: fn(&State) -> f64| {
        let states = rows.iter().map(|row| row.state.transformed(&row.record.scenario.scene.world_from_scene));
        numbers::<Float64Type>(states.map(|state| number(&state)))
    };
    let size = |of: fn(crate::scene::Extent) -> f64| {
        optional_numbers::<Float32Type>(rows.iter().map(|row| row.track().extent.map(|extent| of(extent) as f32)))
    };
    let arrays = vec![
        texts(rows.iter().map(|row| row.record.scenario.id.as_str())),
        texts(rows.iter().map(|row| row.track().id.0.as_str())),
        texts(rows.iter().map(|row| row.track().class.name())),
        texts(rows.iter().map(|row| row.track().role.name())),
        flags(rows.iter().map(|row| row.agent_idx == row.record.scenario.scene.ego_idx)),
        optional_texts(rows.iter().map(Row::event_role)),
        numbers::<UInt32Type>(timesteps?),
        numbers::<Float64Type>(rows.iter().map(|row| row.timestep as f64 * row.record.scenario.scene.dt_s)),
        flags(rows.iter().map(|row| row.record.scenario.observed.is_observed(row.agent_idx, row.timestep))),
        state(0),
        state(1),
        state(2),
        state(3),
        state(4),
        world(|state| state.position.x),
        world(|state| state.position.y),
        world(|state| state.heading_rad),
        size(|extent| extent.length_m),
        size(|extent| extent.width_m),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("tracks", error.to_string()))
}

/// The tracks of one scenario, whose rows are all of `columns`, and which of their states were observed.
pub(crate) fn decode(
    columns: &Columns<'_>,
    n_rows: usize,
    n_timesteps: usize,
) -> Result<(Vec<Track>, ObservationMask)> {
    let ids: &StringArray = columns.get("track_id")?;
    let mut tracks: Vec<(TrackId, Vec<Option<State>>, usize)> = Vec::new();
    let mut observed = BTreeSet::new();
    for row in 0..n_rows {
        let id = ids.value(row);
        if tracks.last().is_none_or(|(last, ..)| last.0 != id) {
            tracks.push((TrackId::from(id), vec![None; n_timesteps], row));
        }
        let number = |name: &str| columns.number::<Float32Type>(name, row);
        let numbers = [number("x_m")?, number("y_m")?, number("heading_rad")?, number("vx_mps")?, number("vy_mps")?];
        let timestep = columns.number::<UInt32Type>("timestep", row)? as usize;
        let entry = tracks.last_mut().and_then(|(_, states, _)| states.get_mut(timestep));
        *entry.ok_or_else(|| Error::corrupt(columns.path, format!("track {id} has a state after the end")))? =
            Some(state_of(numbers));
        if columns.flag("observed", row)? {
            observed.insert((tracks.len() - 1, timestep));
        }
    }
    let is_observed = |agent_idx, timestep| observed.contains(&(agent_idx, timestep));
    let mask = ObservationMask::from_fn(tracks.len(), n_timesteps, is_observed);
    let track = |(id, states, row): (TrackId, Vec<Option<State>>, usize)| {
        Ok(Track {
            id,
            class: columns.named("class", row, AgentClass::from_name)?,
            role: columns.named("recorded_role", row, TrackRole::from_name)?,
            extent: extent_of(
                columns.optional_number::<Float32Type>("length_m", row)?,
                columns.optional_number::<Float32Type>("width_m", row)?,
            ),
            trajectory: Trajectory::new(states),
        })
    };
    Ok((tracks.into_iter().map(track).collect::<Result<_>>()?, mask))
}
