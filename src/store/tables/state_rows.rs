//! The columns of a table with one row a state: agent, time, and position in the frames of the scene and the recording.
//! The tables of tracks and of recordings share them.

use super::columns::{Columns, flags, numbers, optional_numbers, small, texts};
use super::scene_tracks::{extent_of, single, state_of};
use crate::scene::{AgentClass, Extent, Scene, State, Track, TrackId, TrackRole, Trajectory};
use crate::store::schema::{ColumnExt, SCENE_FRAME, WORLD_FRAME, column};
use crate::store::{Error, Result};
use arrow::array::{ArrayRef, StringArray};
use arrow::datatypes::{DataType, Field, Float32Type, Float64Type, UInt32Type};

/// One row: a state of an agent of a scene.
pub(crate) struct StateRow<'r> {
    pub(crate) scene: &'r Scene,
    pub(crate) agent_idx: usize,
    pub(crate) timestep: usize,
    pub(crate) state: &'r State,
}

impl<'r> StateRow<'r> {
    pub(crate) fn track(&self) -> &'r Track {
        &self.scene.tracks[self.agent_idx]
    }
}

/// The rows of a scene, track by track and in each by time.
pub(crate) fn rows_of(scene: &Scene) -> impl Iterator<Item = StateRow<'_>> {
    scene.tracks.iter().enumerate().flat_map(move |(agent_idx, track)| {
        let states = track.trajectory.valid();
        states.map(move |(timestep, state)| StateRow { scene, agent_idx, timestep, state })
    })
}

/// The columns that identify the agent.
pub(crate) fn who_fields(unique_within: &str) -> Vec<Field> {
    vec![
        column(
            "track_id",
            DataType::Utf8,
            &format!("The recording's name for the track; unique within the {unique_within}."),
        ),
        column("class", DataType::Utf8, "Kind of road user."),
        column(
            "recorded_role",
            DataType::Utf8,
            "Its role in the recording: focal, scored, recorder, parked or context.",
        ),
        column(
            "is_center",
            DataType::Boolean,
            "Whether the scene was cut out around it; its present state defines the scene frame.",
        ),
    ]
}

/// The arrays of [`who_fields`].
pub(crate) fn who(rows: &[StateRow<'_>]) -> Vec<ArrayRef> {
    vec![
        texts(rows.iter().map(|row| row.track().id.0.as_str())),
        texts(rows.iter().map(|row| row.track().class.name())),
        texts(rows.iter().map(|row| row.track().role.name())),
        flags(rows.iter().map(|row| row.agent_idx == row.scene.ego_idx)),
    ]
}

/// The columns of time.
pub(crate) fn when_fields() -> Vec<Field> {
    vec![
        column("timestep", DataType::UInt32, "Timestep, from 0.").unit("1"),
        column("t_s", DataType::Float64, "Time since timestep 0.").unit("s"),
    ]
}

/// The arrays of [`when_fields`].
pub(crate) fn when(rows: &[StateRow<'_>]) -> Result<Vec<ArrayRef>> {
    let timesteps: Result<Vec<u32>> = rows.iter().map(|row| small(&row.scene.id.0, "timestep", row.timestep)).collect();
    Ok(vec![
        numbers::<UInt32Type>(timesteps?),
        numbers::<Float64Type>(rows.iter().map(|row| row.timestep as f64 * row.scene.dt_s)),
    ])
}

/// The definition of velocities, for the description of their columns.
const VELOCITY: &str = "It is that at the timestep: of observed states as ingested, of all others the slope of the \
    parabola through the positions before, at and after it (the central difference), or through the last three.";

/// The columns of position, motion and size.
pub(crate) fn state_fields() -> Vec<Field> {
    let scene = |name: &str, unit: &str, description: &str| {
        column(name, DataType::Float32, description).unit(unit).frame(SCENE_FRAME)
    };
    let world = |name: &str, unit: &str, description: &str| {
        column(name, DataType::Float64, description).unit(unit).frame(WORLD_FRAME)
    };
    let size = |name: &str, description: &str| column(name, DataType::Float32, description).unit("m").optional();
    vec![
        scene("x_m", "m", "Position of its center along x."),
        scene("y_m", "m", "Position of its center along y."),
        scene("heading_rad", "rad", "Direction in which it points, in (-π, π]; 0 is along x."),
        scene("vx_mps", "m/s", &format!("Velocity along x. {VELOCITY}")),
        scene("vy_mps", "m/s", &format!("Velocity along y. {VELOCITY}")),
        world("world_x_m", "m", "Position of its center along x."),
        world("world_y_m", "m", "Position of its center along y."),
        world("world_heading_rad", "rad", "Direction in which it points, in (-π, π]; 0 is along x."),
        size("length_m", "Size along the heading; missing if the recording gives none."),
        size("width_m", "Size across the heading; missing if the recording gives none."),
    ]
}

/// The arrays of [`state_fields`].
pub(crate) fn states(rows: &[StateRow<'_>]) -> Vec<ArrayRef> {
    let state = |i: usize| numbers::<Float32Type>(rows.iter().map(move |row| single(row.state)[i]));
    let world = |number: fn(&State) -> f64| {
        let states = rows.iter().map(|row| row.state.transformed(&row.scene.world_from_scene));
        numbers::<Float64Type>(states.map(|state| number(&state)))
    };
    let size = |of: fn(Extent) -> f64| {
        optional_numbers::<Float32Type>(rows.iter().map(|row| row.track().extent.map(|extent| of(extent) as f32)))
    };
    vec![
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
    ]
}

/// The tracks of one scene, whose rows are all of `columns`; `visit` sees the track, timestep and row of each state.
pub(crate) fn decode(
    columns: &Columns<'_>,
    n_rows: usize,
    n_timesteps: usize,
    mut visit: impl FnMut(usize, usize, usize) -> Result<()>,
) -> Result<Vec<Track>> {
    let ids: &StringArray = columns.get("track_id")?;
    let mut tracks: Vec<(TrackId, Vec<Option<State>>, usize)> = Vec::new();
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
        visit(tracks.len() - 1, timestep, row)?;
    }
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
    tracks.into_iter().map(track).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Transform2, Vec2};
    use crate::scene::testing::{Drive, scene};
    use arrow::array::AsArray;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn columns_are_in_the_frames_that_they_name() {
        let mut scene = scene(&[Drive::straight(1.0, 2.0, 0.25, 10.0)]);
        scene.world_from_scene = Transform2::from_pose(Vec2::new(100.0, 50.0), FRAC_PI_2);
        let (fields, arrays) = (state_fields(), states(&rows_of(&scene).collect::<Vec<_>>()));
        let first = |name: &str| {
            let array = &arrays[fields.iter().position(|field| field.name() == name).unwrap()];
            let narrow = array.as_primitive_opt::<Float32Type>().map(|array| f64::from(array.value(0)));
            narrow.unwrap_or_else(|| array.as_primitive::<Float64Type>().value(0))
        };
        let expected = [
            ("x_m", 1.0),
            ("y_m", 2.0),
            ("heading_rad", 0.25),
            ("vx_mps", 10.0 * 0.25_f64.cos()),
            ("vy_mps", 10.0 * 0.25_f64.sin()),
            ("world_x_m", 98.0),
            ("world_y_m", 51.0),
            ("world_heading_rad", 0.25 + FRAC_PI_2),
            ("length_m", 4.5),
            ("width_m", 1.8),
        ];
        for (name, expected) in expected {
            assert!((first(name) - expected).abs() < 1e-6, "{name}: {}, expected {expected}", first(name));
        }
    }
}
