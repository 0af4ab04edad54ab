//! Argoverse's submissions: one Parquet file, one row a track and mode.

use super::predicted;
use crate::metrics::Modes;
use crate::scene::{Benchmark, Scene, TrackRole};
use crate::store::Result;
use crate::store::parquet_file::ParquetFile;
use crate::store::tables::prediction::{PredictionRow, encode, schema};
use std::path::Path;

/// Writes a file as Argoverse 2's API does (`scenario_id`, `track_id`, `probability`, `predicted_trajectory_x`,
/// `predicted_trajectory_y`), in the recording's frame.
///
/// For Argoverse 2, the focal and scored tracks are predicted, each with the probability of the joint mode; for
/// Argoverse 1, the agent. The benchmark of Argoverse 1 took HDF5, which is not written here; the columns hold the data
/// that it needs.
pub struct ArgoversePredictions {
    file: ParquetFile,
}

impl ArgoversePredictions {
    /// Begins the file.
    pub fn create(path: &Path) -> Result<Self> {
        Ok(Self { file: ParquetFile::create(path, &schema(), schema().arrow())? })
    }

    /// Adds the modes of a scene. Returns the number of required tracks that were left out because a mode lacks a
    /// state.
    pub fn add(&mut self, recorded: &Scene, modes: &Modes) -> Result<usize> {
        let has_worlds = recorded.source.dataset.facts().benchmark == Some(Benchmark::ArgoverseWorlds);
        let is_target = |role: TrackRole| role == TrackRole::Focal || (role == TrackRole::Scored && has_worlds);
        let mut n_left_out = 0;
        let mut rows = Vec::new();
        for (agent_idx, track) in recorded.tracks.iter().enumerate().filter(|(_, track)| is_target(track.role)) {
            let Some(states) = predicted(recorded, modes, agent_idx) else {
                n_left_out += 1;
                continue;
            };
            let row = |(states, probability): (&Vec<crate::scene::State>, &f64)| PredictionRow {
                scenario_id: recorded.source.case_id.clone(),
                track_id: track.id.0.clone(),
                probability: *probability,
                x_m: states.iter().map(|state| state.position.x).collect(),
                y_m: states.iter().map(|state| state.position.y).collect(),
            };
            rows.extend(states.iter().zip(&modes.probabilities).map(row));
        }
        if !rows.is_empty() {
            self.file.write(&encode(&rows)?)?;
        }
        Ok(n_left_out)
    }

    /// Gives the file its name.
    pub fn finish(self) -> Result<()> {
        self.file.finish().map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Transform2, Vec2};
    use crate::scene::Dataset;
    use crate::scene::testing::{self, Drive};
    use crate::store::parquet_file;
    use crate::store::tables::columns::Columns;
    use arrow::array::{Array, AsArray};
    use arrow::datatypes::Float64Type;

    #[test]
    fn each_track_to_predict_has_a_row_for_each_mode() {
        let drives = [0.0, 9.0, 18.0].map(|y| Drive::straight(0.0, y, 0.0, 10.0));
        let mut recorded = testing::scene(&drives);
        recorded.source.case_id = "0a1b".to_owned();
        recorded.world_from_scene = Transform2::from_pose(Vec2::new(1000.0, 2000.0), 0.0);
        recorded.tracks[0].role = TrackRole::Focal;
        recorded.tracks[1].role = TrackRole::Scored;
        let other = testing::scene(&[drives[0], Drive::straight(1.0, 9.0, 0.0, 10.0), drives[2]]);
        let modes = Modes { samples: vec![recorded.clone(), other], probabilities: vec![0.75, 0.25] };
        for (dataset, expected) in [
            (
                Dataset::Argoverse2,
                vec![("1", 0.75, 1004.0), ("1", 0.25, 1004.0), ("2", 0.75, 1004.0), ("2", 0.25, 1005.0)],
            ),
            (Dataset::Argoverse1, vec![("1", 0.75, 1004.0), ("1", 0.25, 1004.0)]),
        ] {
            recorded.source.dataset = dataset;
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("predictions.parquet");
            let mut predictions = ArgoversePredictions::create(&path).unwrap();
            assert_eq!(predictions.add(&recorded, &modes).unwrap(), 0);
            predictions.finish().unwrap();
            let batches = parquet_file::read(&path, &schema()).unwrap();
            let columns = Columns::of_batch(&batches[0], &path);
            let x = |row: usize| batches[0].column(3).as_list::<i32>().value(row);
            let found: Vec<(&str, f64, f64)> = (0..batches[0].num_rows())
                .map(|row| {
                    assert_eq!((columns.text("scenario_id", row).unwrap(), x(row).len()), ("0a1b", 8));
                    let track_id = columns.text("track_id", row).unwrap();
                    let probability = columns.number::<Float64Type>("probability", row).unwrap();
                    // After 0.4 s, in a scene that lies 1000 m to the east.
                    (track_id, probability, x(row).as_primitive::<Float64Type>().value(0))
                })
                .collect();
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!((found.0, found.1), (expected.0, expected.1));
                assert!((found.2 - expected.2).abs() < 1e-9, "{found:?}");
            }
        }
    }
}
