//! The tracks of a scene as one nested column, and the precision of stored states.

use super::columns::{Columns, entries, flags, lists, numbers, optional_numbers, structs, texts};
use crate::geometry::Vec2;
use crate::scene::{AgentClass, Extent, Scene, State, Track, TrackId, TrackRole, Trajectory};
use crate::store::schema::{ColumnExt, SCENE_FRAME, column, list_of, list_of_structs};
use crate::store::{Error, Result};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, Float32Type};
use std::f64::consts::PI;

/// The column of all tracks.
pub(crate) fn field() -> Field {
    let states = |name: &str, unit: &str, description: &str| {
        column(name, list_of(DataType::Float32), description).unit(unit).frame(SCENE_FRAME)
    };
    let size = |name: &str, description: &str| column(name, DataType::Float32, description).unit("m").optional();
    let fields = vec![
        column("track_id", DataType::Utf8, "The recording's name for the track."),
        column("class", DataType::Utf8, "Kind of road user."),
        column("role", DataType::Utf8, "Its role in the recording: focal, scored, recorder, parked or context."),
        size("length_m", "Size along the heading; missing if the recording gives none."),
        size("width_m", "Size across the heading; missing if the recording gives none."),
        states("x_m", "m", "Center, one entry a timestep; 0 if not valid."),
        states("y_m", "m", "Center, one entry a timestep; 0 if not valid."),
        states("heading_rad", "rad", "Direction in (-π, π], one entry a timestep; 0 if not valid."),
        states("vx_mps", "m/s", "Velocity, one entry a timestep; 0 if not valid."),
        states("vy_mps", "m/s", "Velocity, one entry a timestep; 0 if not valid."),
        column("valid", list_of(DataType::Boolean), "Whether the agent was tracked, one entry a timestep."),
    ];
    column("tracks", list_of_structs(fields), "The road users, in a fixed order.")
}

/// The array of these scenes' tracks.
pub(crate) fn encode(scenes: &[&Scene]) -> Result<ArrayRef> {
    let tracks = || scenes.iter().flat_map(|scene| &scene.tracks);
    let mut states: [Vec<f32>; 5] = Default::default();
    let (mut valid, mut lengths) = (Vec::new(), Vec::new());
    for scene in scenes {
        for track in &scene.tracks {
            if track.trajectory.n_timesteps() != scene.n_timesteps {
                return Err(Error::invalid(
                    &scene.id,
                    format!("track {} has a different number of timesteps", track.id),
                ));
            }
            lengths.push(scene.n_timesteps);
            for (timestep, state) in track.trajectory.entries().iter().enumerate() {
                let numbers = state.as_ref().map_or([0.0; 5], single);
                if numbers.iter().any(|number| !number.is_finite()) {
                    let detail = format!("track {} is not finite at timestep {timestep}", track.id);
                    return Err(Error::invalid(&scene.id, detail));
                }
                valid.push(state.is_some());
                for (column, number) in states.iter_mut().zip(numbers) {
                    column.push(number);
                }
            }
        }
    }
    let size = |of: fn(Extent) -> f64| {
        optional_numbers::<Float32Type>(tracks().map(|track| track.extent.map(|extent| of(extent) as f32)))
    };
    let mut arrays = vec![
        texts(tracks().map(|track| track.id.0.as_str())),
        texts(tracks().map(|track| track.class.name())),
        texts(tracks().map(|track| track.role.name())),
        size(|extent| extent.length_m),
        size(|extent| extent.width_m),
    ];
    arrays.extend(states.into_iter().map(|column| lists(lengths.iter().copied(), numbers::<Float32Type>(column))));
    arrays.push(lists(lengths, flags(valid)));
    let values = structs("tracks", field().data_type(), arrays)?;
    Ok(lists(scenes.iter().map(|scene| scene.tracks.len()), values))
}

pub(crate) fn decode(columns: &Columns<'_>, row: usize, n_timesteps: usize) -> Result<Vec<Track>> {
    let (list, members) = columns.of_list("tracks")?;
    entries(list, row).map(|entry| decode_track(&members, entry, n_timesteps)).collect()
}

fn decode_track(columns: &Columns<'_>, entry: usize, n_timesteps: usize) -> Result<Track> {
    let numbers = |name: &str| columns.numbers::<Float32Type>(name, entry);
    let states = [numbers("x_m")?, numbers("y_m")?, numbers("heading_rad")?, numbers("vx_mps")?, numbers("vy_mps")?];
    let valid = columns.flags("valid", entry)?;
    let id = TrackId(columns.text("track_id", entry)?.to_owned());
    if states.iter().any(|column| column.len() != n_timesteps) || valid.values().len() != n_timesteps {
        return Err(Error::corrupt(columns.path, format!("track {id} does not have as many timesteps as its scene")));
    }
    let state = |timestep: usize| {
        let numbers = states.map(|column| column[timestep]);
        valid.values().value(timestep).then(|| state_of(numbers))
    };
    Ok(Track {
        id,
        class: columns.named("class", entry, AgentClass::from_name)?,
        role: columns.named("role", entry, TrackRole::from_name)?,
        extent: extent_of(
            columns.optional_number::<Float32Type>("length_m", entry)?,
            columns.optional_number::<Float32Type>("width_m", entry)?,
        ),
        trajectory: Trajectory::new((0..n_timesteps).map(state).collect()),
    })
}

/// The size in a row.
pub(crate) fn extent_of(length_m: Option<f32>, width_m: Option<f32>) -> Option<Extent> {
    let (length_m, width_m) = (length_m?, width_m?);
    Some(Extent { length_m: f64::from(length_m), width_m: f64::from(width_m) })
}

/// A state as x, y, heading, vx, vy in single precision.
pub(crate) fn single(state: &State) -> [f32; 5] {
    let State { position, heading_rad, velocity } = *state;
    [position.x as f32, position.y as f32, single_heading(heading_rad), velocity.x as f32, velocity.y as f32]
}

/// Rounds toward zero near ±π: the nearest single-precision number would lie outside (-π, π].
fn single_heading(heading_rad: f64) -> f32 {
    let rounded = heading_rad as f32;
    if f64::from(rounded).abs() > PI && heading_rad.abs() <= PI {
        f32::from_bits(rounded.to_bits() - 1)
    } else {
        rounded
    }
}

pub(crate) fn state_of([x, y, heading, vx, vy]: [f32; 5]) -> State {
    State {
        position: Vec2::new(f64::from(x), f64::from(y)),
        heading_rad: f64::from(heading),
        velocity: Vec2::new(f64::from(vx), f64::from(vy)),
    }
}

/// The scene as the store returns it: states and sizes rounded to single precision (below 0.01 mm within 100 m). Apply
/// it to generated scenes before they are verified, so that the verified states are the written ones.
pub fn as_stored(scene: &Scene) -> Scene {
    let rounded = |number: f64| f64::from(number as f32);
    let track = |track: &Track| Track {
        extent: track.extent.map(|e| Extent { length_m: rounded(e.length_m), width_m: rounded(e.width_m) }),
        trajectory: Trajectory::new(
            track.trajectory.entries().iter().map(|state| state.as_ref().map(|s| state_of(single(s)))).collect(),
        ),
        ..track.clone()
    };
    Scene { tracks: scene.tracks.iter().map(track).collect(), ..scene.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rounding_is_close_and_done_once(x in -300.0..300.0f64, y in -300.0..300.0f64, heading in -PI..=PI) {
            let state = State { position: Vec2::new(x, y), heading_rad: heading, velocity: Vec2::new(y, x) };
            let once = state_of(single(&state));
            prop_assert!(once.position.distance(state.position) < 1e-4);
            prop_assert!((once.heading_rad - heading).abs() < 1e-6);
            prop_assert_eq!(state_of(single(&once)), once);
        }
    }

    #[test]
    fn headings_stay_within_half_a_turn() {
        for heading in [PI, -PI, PI - 1e-9, -PI + 1e-9] {
            let rounded = f64::from(single_heading(heading));
            assert!(rounded.abs() <= PI && (rounded - heading).abs() < 1e-6, "{heading} became {rounded}");
        }
    }
}
