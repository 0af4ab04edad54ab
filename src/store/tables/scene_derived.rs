//! The derived values of a scene's tracks as one nested column: held headings, smoothed positions.

use super::columns::{Columns, entries, flags, lists, numbers, structs, texts};
use crate::geometry::Vec2;
use crate::scene::{Derivation, RecordedPosition, Scene, Track};
use crate::store::schema::{ColumnExt, SCENE_FRAME, column, list_of, list_of_structs};
use crate::store::{Error, Result};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, Float32Type};

const NAME: &str = "derived";

pub(crate) fn field() -> Field {
    let recorded = |name: &str, unit: &str, description: &str| {
        column(name, list_of(DataType::Float32), description).unit(unit).frame(SCENE_FRAME)
    };
    let fields = vec![
        column("track_id", DataType::Utf8, "The track, among those of the scene."),
        column(
            "heading_held",
            list_of(DataType::Boolean),
            "Whether the heading is held because the agent moves too slowly, one entry a timestep; otherwise it \
             follows from the motion.",
        ),
        recorded(
            "recorded_t_s",
            "s",
            "If states are smoothed, the times after the present at which the agent was recorded; otherwise empty.",
        ),
        recorded("recorded_x_m", "m", "Recorded center, one entry a recorded time."),
        recorded("recorded_y_m", "m", "Recorded center, one entry a recorded time."),
    ];
    column(NAME, list_of_structs(fields), "The tracks whose headings, or whose whole states, are not as recorded.")
}

/// The array of the derived values of these scenes.
pub(crate) fn encode(scenes: &[&Scene]) -> Result<ArrayRef> {
    let (mut n_of_scene, mut ids) = (Vec::new(), Vec::new());
    let (mut n_held, mut held) = (Vec::new(), Vec::new());
    let mut n_recorded = Vec::new();
    let mut recorded: [Vec<f32>; 3] = Default::default();
    for scene in scenes {
        let before = ids.len();
        for track in &scene.tracks {
            let Some(derivation) = track.trajectory.derivation() else { continue };
            if derivation.held_headings.len() != scene.n_timesteps {
                let detail = format!("track {} has derived headings for a different number of timesteps", track.id);
                return Err(Error::invalid(&scene.id, detail));
            }
            ids.push(track.id.0.as_str());
            n_held.push(derivation.held_headings.len());
            held.extend(&derivation.held_headings);
            n_recorded.push(derivation.recorded.len());
            for RecordedPosition { time_s, position } in &derivation.recorded {
                for (column, number) in recorded.iter_mut().zip([*time_s, position.x, position.y]) {
                    column.push(number as f32);
                }
            }
        }
        n_of_scene.push(ids.len() - before);
    }
    let mut arrays = vec![texts(ids), lists(n_held, flags(held))];
    arrays.extend(recorded.map(|column| lists(n_recorded.iter().copied(), numbers::<Float32Type>(column))));
    Ok(lists(n_of_scene, structs(NAME, field().data_type(), arrays)?))
}

/// Adds the derived values in a row to the `tracks` of its scene.
pub(crate) fn decode(columns: &Columns<'_>, row: usize, tracks: &mut [Track]) -> Result<()> {
    let (list, members) = columns.of_list(NAME)?;
    for entry in entries(list, row) {
        let id = members.text("track_id", entry)?;
        let corrupt = |detail: &str| Error::corrupt(columns.path, format!("track {id}: {detail}"));
        let track = tracks.iter_mut().find(|track| track.id.0 == id);
        let track = track.ok_or_else(|| corrupt("it has derived values but is not in its scene"))?;
        let held_headings: Vec<bool> = members.flags("heading_held", entry)?.values().iter().collect();
        let numbers = |name: &str| members.numbers::<Float32Type>(name, entry);
        let [t_s, x_m, y_m] = [numbers("recorded_t_s")?, numbers("recorded_x_m")?, numbers("recorded_y_m")?];
        if held_headings.len() != track.trajectory.n_timesteps() || [x_m.len(), y_m.len()] != [t_s.len(); 2] {
            return Err(corrupt("its derived values have a different number of entries"));
        }
        let position = |i: usize| RecordedPosition {
            time_s: f64::from(t_s[i]),
            position: Vec2::new(f64::from(x_m[i]), f64::from(y_m[i])),
        };
        let derivation = Derivation { held_headings, recorded: (0..t_s.len()).map(position).collect() };
        track.trajectory = std::mem::take(&mut track.trajectory).derived(derivation);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Trajectory;
    use crate::store::maps::MapTable;
    use crate::store::tables::scene;
    use crate::store::testing;
    use arrow::array::RecordBatch;
    use std::path::Path;

    #[test]
    fn what_was_derived_is_read_back() {
        let mut scene = testing::scene(7, None);
        let held_headings: Vec<bool> = (0..scene.n_timesteps).map(|timestep| timestep % 3 == 0).collect();
        let recorded = [(-0.5, 1.0, 2.0), (0.25, 3.0, 4.5)]
            .map(|(time_s, x, y)| RecordedPosition { time_s, position: Vec2::new(x, y) });
        for (track, recorded) in scene.tracks.iter_mut().zip([recorded.to_vec(), Vec::new()]) {
            let derivation = Derivation { held_headings: held_headings.clone(), recorded };
            track.trajectory = std::mem::take(&mut track.trajectory).derived(derivation);
        }
        let batch = scene::encode(&[scene.clone(), testing::scene(8, None)]).unwrap();
        let read = |batch: &RecordBatch, row: usize| {
            scene::decode(&Columns::of_batch(batch, Path::new("test.arrow")), row, &MapTable::default()).unwrap()
        };
        let derivations = |scene: &Scene| -> Vec<Option<Derivation>> {
            scene.tracks.iter().map(|track| track.trajectory.derivation().cloned()).collect()
        };
        assert_eq!(derivations(&read(&batch, 0)), derivations(&scene));
        assert!(derivations(&read(&batch, 1)).iter().all(Option::is_none));

        scene.tracks[0].trajectory = Trajectory::default().derived(Derivation::default());
        assert!(scene::encode(&[scene]).is_err());
    }
}
