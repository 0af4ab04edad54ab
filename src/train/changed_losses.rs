//! The loss on changed held-out scenes, which shows whether a denoiser uses the map and other agents.

use super::{DenoisingTask, Error};
use crate::geometry::{Transform2, Vec2};
use crate::model::{ChangedLoss, PlaceLoss, SceneChange};
use crate::scene::{LaneGraph, Scene};
use crate::tensor::{SceneBatch, SceneTensors};
use candle_core::Tensor;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Noise levels at which maneuvers are decided.
const SIGMAS: [f64; 2] = [0.8, 3.0];
/// How far lanes are shifted, meters.
const SHIFT_M: f64 = 4.0;
/// If a turned map raises the loss by less than this, it makes no difference.
const MIN_RATIO: f64 = 1.1;

/// The losses of the denoiser under each change.
pub(super) fn changed_losses(task: &DenoisingTask<'_>) -> Result<Vec<ChangedLoss>, Error> {
    let held_out = task.draws.held_out;
    if held_out.is_empty() {
        return Ok(Vec::new());
    }
    let mut found = Vec::with_capacity(SceneChange::ALL.len() * SIGMAS.len());
    for change in SceneChange::ALL {
        let losses = losses_of(task, held_out, change, &SIGMAS)?;
        found.extend(SIGMAS.into_iter().zip(losses).map(|(sigma, loss)| ChangedLoss { change, sigma, loss }));
    }
    Ok(found)
}

/// The losses of the denoiser place by place, in the order of their names.
pub(super) fn losses_by_place(task: &DenoisingTask<'_>) -> Result<Vec<PlaceLoss>, Error> {
    let mut places: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for idx in task.draws.held_out {
        let scene = task.draws.dataset.scene(*idx).map_err(Error::Scene)?;
        places.entry(scene.source.place).or_default().push(*idx);
    }
    let mut found = Vec::with_capacity(places.len() * SIGMAS.len());
    for (place, scenes) in places {
        let losses = losses_of(task, &scenes, SceneChange::AsRecorded, &SIGMAS)?;
        let turned = losses_of(task, &scenes, SceneChange::MapTurned, &SIGMAS)?;
        let n_scenes = scenes.len() as u64;
        found.extend(SIGMAS.into_iter().zip(losses).zip(turned).map(|((sigma, loss), map_turned)| PlaceLoss {
            place: place.clone(),
            n_scenes,
            sigma,
            loss,
            map_turned,
        }));
    }
    Ok(found)
}

/// The mean loss over held-out scenes after a change, at each of these noise levels.
pub(super) fn losses_of(
    task: &DenoisingTask<'_>,
    scenes: &[usize],
    change: SceneChange,
    sigmas: &[f64],
) -> Result<Vec<f64>, Error> {
    task.draws.changed_means(scenes, sigmas.len(), &|_, scene| changed(scene, change), |drawn| {
        let (batch, seeds) = (&drawn.batch, &drawn.seeds);
        let batch = match change {
            SceneChange::EgoOnly | SceneChange::EgoAlone => of_egos(batch)?,
            _ => batch.clone(),
        };
        sigmas.iter().map(|sigma| task.held_out_loss(&batch, *sigma, seeds)).collect()
    })
}

/// Warnings about a denoiser with these losses: the noise levels at which a turned map makes no difference.
pub fn map_warnings(losses: &[ChangedLoss]) -> Vec<String> {
    let at = |change: SceneChange, sigma: f64| {
        losses.iter().find(|found| found.change == change && found.sigma == sigma).map(|found| found.loss)
    };
    let warning = |sigma: f64| {
        let recorded = at(SceneChange::AsRecorded, sigma)?;
        let ratio = at(SceneChange::MapTurned, sigma)? / recorded;
        let has_map = at(SceneChange::NoMap, sigma)? != recorded;
        (has_map && ratio < MIN_RATIO).then(|| {
            format!(
                "the denoiser barely uses the map: with lanes rotated by 90 degrees its held-out loss at sigma {sigma} \
                 is {ratio:.2} times that with the true lanes; train longer, or on more places"
            )
        })
    };
    SIGMAS.into_iter().filter_map(warning).collect()
}

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

/// The batch with only each row's ego agent scored: the one at the origin of the row's frame at present.
fn of_egos(batch: &SceneBatch) -> Result<SceneBatch, Error> {
    let (n_rows, n_agents, _) = batch.scored.dims3()?;
    let mut is_ego = vec![0.0f32; n_rows * n_agents];
    for (row, frame) in batch.frames.iter().enumerate() {
        if let Some(slot) = frame.ego_slot() {
            is_ego[row * n_agents + slot] = 1.0;
        }
    }
    let is_ego = Tensor::from_vec(is_ego, (n_rows, n_agents, 1), batch.scored.device())?;
    let scored = batch.scored.broadcast_mul(&is_ego)?;
    Ok(SceneBatch::new(SceneTensors { scored, ..SceneTensors::clone(batch) })?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn a_map_that_makes_no_difference_is_warned_of() {
        let losses = |turned: f64, none: f64| {
            let loss = |change, loss| ChangedLoss { change, sigma: 0.8, loss };
            [loss(SceneChange::AsRecorded, 0.2), loss(SceneChange::MapTurned, turned), loss(SceneChange::NoMap, none)]
        };
        let warnings = map_warnings(&losses(0.21, 0.19));
        assert!(warnings.len() == 1 && warnings[0].contains("at sigma 0.8 is 1.05 times"), "{warnings:?}");
        assert!(map_warnings(&losses(0.3, 0.4)).is_empty());
        // Without a map or held-out scenes, there is no warning.
        assert!(map_warnings(&losses(0.2, 0.2)).is_empty() && map_warnings(&[]).is_empty());
    }

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
        // The left of a vehicle that heads along +y is -x.
        assert!(lane(SceneChange::MapShifted).distance(before + Vec2::new(-SHIFT_M, 0.0)) < 1e-9);
        assert!(lane(SceneChange::AsRecorded).distance(before) == 0.0);
        assert!(changed(made.clone(), SceneChange::NoMap).lanes.lanes().is_empty());
        let alone = changed(Scene { ego_idx: 1, ..made.clone() }, SceneChange::EgoAlone);
        assert_eq!((alone.tracks.len(), alone.ego_idx, &alone.tracks[0].id), (1, 0, &made.tracks[1].id));
    }
}
