//! Does a denoiser look at the map and at other agents? Its loss on held-out scenes of which something was changed.

use super::{DenoisingTask, Error};
use crate::geometry::{Transform2, Vec2};
use crate::model::{ChangedLoss, SceneChange};
use crate::progress::Progress;
use crate::scene::{LaneGraph, Scene};
use crate::tensor::SceneBatch;
use candle_core::Tensor;
use std::sync::Arc;

/// Noise levels at which maneuvers are decided.
const SIGMAS: [f64; 2] = [0.8, 3.0];
/// How far lanes are shifted, meters.
const SHIFT_M: f64 = 4.0;
/// A turned map that raises the loss by less than this makes no difference.
const MIN_RATIO: f64 = 1.1;

/// The losses of the trained denoiser under each change; warns when a turned map makes no difference.
pub(super) fn changed_losses(task: &DenoisingTask<'_>, progress: &dyn Progress) -> Result<Vec<ChangedLoss>, Error> {
    if task.draws.held_out.is_empty() {
        return Ok(Vec::new());
    }
    let mut found = Vec::with_capacity(SceneChange::ALL.len() * SIGMAS.len());
    for change in SceneChange::ALL {
        let losses = task.draws.changed_means(SIGMAS.len(), &|scene| changed(scene, change), |drawn| {
            let (batch, seeds) = (&drawn.batch, &drawn.seeds);
            let batch = match change {
                SceneChange::EgoOnly | SceneChange::EgoAlone => of_egos(batch)?,
                _ => batch.clone(),
            };
            let loss = |sigma: f64| task.held_out_loss(&batch, sigma, seeds);
            SIGMAS.into_iter().map(loss).collect()
        })?;
        found.extend(SIGMAS.into_iter().zip(losses).map(|(sigma, loss)| ChangedLoss { change, sigma, loss }));
    }
    let loss = |change: SceneChange, sigma: f64| {
        found.iter().find(|l| l.change == change && l.sigma == sigma).map_or(f64::NAN, |l| l.loss)
    };
    for sigma in SIGMAS {
        let ratio = loss(SceneChange::MapTurned, sigma) / loss(SceneChange::AsRecorded, sigma);
        let has_map = loss(SceneChange::NoMap, sigma) != loss(SceneChange::AsRecorded, sigma);
        if has_map && ratio < MIN_RATIO {
            progress.note(&format!(
                "the network hardly looks at the map: with lanes turned by 90 degrees its held-out loss at sigma {sigma} is \
                 {ratio:.2} times that with the true ones; train longer, or on more places"
            ));
        }
    }
    Ok(found)
}

/// The scene after a change.
fn changed(scene: Scene, change: SceneChange) -> Scene {
    let ego = scene.state(scene.ego_idx, scene.current_timestep());
    let scene_from_ego = ego.map_or(Transform2::IDENTITY, |ego| Transform2::from_pose(ego.position, ego.heading_rad));
    let moved = |in_ego_frame: Transform2| {
        let move_lanes = scene_from_ego.compose(&in_ego_frame).compose(&scene_from_ego.inverse());
        Arc::new(scene.lanes.transformed(&move_lanes))
    };
    match change {
        SceneChange::AsRecorded | SceneChange::EgoOnly => scene,
        SceneChange::MapTurned => {
            Scene { lanes: moved(Transform2::from_pose(Vec2::ZERO, std::f64::consts::FRAC_PI_2)), ..scene }
        }
        SceneChange::MapShifted => Scene { lanes: moved(Transform2::from_pose(Vec2::new(0.0, SHIFT_M), 0.0)), ..scene },
        SceneChange::NoMap => Scene { lanes: Arc::new(LaneGraph::default()), ..scene },
        SceneChange::EgoAlone => {
            let ego = scene.tracks.get(scene.ego_idx).cloned();
            Scene { tracks: ego.into_iter().collect(), ego_idx: 0, ..scene }
        }
    }
}

/// The batch with a loss of each row's ego agent alone: the one at the origin of the row's frame at the present.
fn of_egos(batch: &SceneBatch) -> Result<SceneBatch, Error> {
    let (n_rows, n_agents, _) = batch.scored.dims3()?;
    let mut is_ego = vec![0.0f32; n_rows * n_agents];
    for (row, frame) in batch.frames.iter().enumerate() {
        if let Some(slot) = frame.ego_slot() {
            is_ego[row * n_agents + slot] = 1.0;
        }
    }
    let is_ego = Tensor::from_vec(is_ego, (n_rows, n_agents, 1), batch.scored.device())?;
    Ok(SceneBatch { scored: batch.scored.broadcast_mul(&is_ego)?, ..batch.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn maps_turn_and_shift_around_the_ego_and_others_leave() {
        // The ego drives along +y; a lane lies along x.
        let made =
            scene(&[Drive::straight(0.0, 0.0, std::f64::consts::FRAC_PI_2, 10.0), Drive::straight(5.0, 5.0, 0.0, 3.0)]);
        let ego = made.state(0, made.current_timestep()).unwrap().position;
        let before = made.lanes.lanes()[0].centerline.0[0] - ego;
        let lane = |change: SceneChange| changed(made.clone(), change).lanes.lanes()[0].centerline.0[0] - ego;
        let turned = before.rotated(std::f64::consts::FRAC_PI_2);
        assert!(lane(SceneChange::MapTurned).distance(turned) < 1e-9);
        // To the left of somebody who heads along +y is -x.
        assert!(lane(SceneChange::MapShifted).distance(before + Vec2::new(-SHIFT_M, 0.0)) < 1e-9);
        assert!(lane(SceneChange::AsRecorded).distance(before) == 0.0);
        assert!(changed(made.clone(), SceneChange::NoMap).lanes.lanes().is_empty());
        let alone = changed(Scene { ego_idx: 1, ..made.clone() }, SceneChange::EgoAlone);
        assert_eq!((alone.tracks.len(), alone.ego_idx, &alone.tracks[0].id), (1, 0, &made.tracks[1].id));
    }
}
