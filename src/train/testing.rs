//! Helpers that the tests of training share: scenes made by a function, jobs, and draws.

use super::{Prefetched, SceneDataset, SceneDraws, TrainJob, TrainingData, TrainingSource, WeightedGroups};
use crate::nn::Compute;
use crate::progress::Silent;
use crate::scene::testing::{Drive, scene};
use crate::scene::{Scene, Trajectory};
use crate::seed::Seed;
use crate::tensor::{self, Collator, MaskSampler, StateParametrization, TaskWeights};
use std::path::Path;

static CPU: Compute = Compute::cpu();

/// This many scenes, made by a function of their index.
pub(super) struct MadeScenes<F>(pub(super) usize, pub(super) F);

pub(super) trait Counted: SceneDataset {
    fn len(&self) -> usize;
}

impl<F: Fn(usize) -> Scene + Sync> Counted for MadeScenes<F> {
    fn len(&self) -> usize {
        self.0
    }
}

impl<F: Fn(usize) -> Scene + Sync> SceneDataset for MadeScenes<F> {
    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
        Ok((self.1)(idx))
    }
}

/// Two cars each: one drives on, one turns from the present on, at a speed that shows in its history.
pub(super) fn arcs(n: usize) -> MadeScenes<impl Fn(usize) -> Scene + Sync> {
    let mut rng = Seed(11).rng();
    let speeds_mps: Vec<f64> = (0..n).map(|_| 6.0 + 6.0 * rng.uniform()).collect();
    MadeScenes(n, move |idx: usize| {
        let car = Drive { x: 10.0, y: 4.0, heading_rad: 0.2, speed_mps: speeds_mps[idx], curvature_1pm: 0.0 };
        turning_from_the_present(scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), car]), 1, car, 0.05)
    })
}

/// The scene with its `track_idx`-th track, which drives straight as `car`, bending from the present on.
fn turning_from_the_present(mut scene: Scene, track_idx: usize, car: Drive, curvature_1pm: f64) -> Scene {
    let present = scene.current_timestep();
    let way_m = car.speed_mps * scene.dt_s * present as f64;
    let (x, y) = (car.x + way_m * car.heading_rad.cos(), car.y + way_m * car.heading_rad.sin());
    let bend = self::scene(&[Drive { x, y, curvature_1pm, ..car }]);
    let track = &mut scene.tracks[track_idx].trajectory;
    let state = |t: usize| match t.checked_sub(present) {
        None | Some(0) => track.get(t),
        Some(elapsed) => bend.tracks[0].trajectory.get(elapsed),
    };
    *track = Trajectory::new((0..scene.n_timesteps).map(|t| state(t).copied()).collect());
    scene
}

/// The other agents, and last a car that bears left or right from the present on, which cannot be predicted.
pub(super) fn fork(idx: usize, others: &[Drive]) -> Scene {
    let side = if idx.is_multiple_of(2) { 1.0 } else { -1.0 };
    let car = Drive::straight(0.0, 0.0, 0.0, 15.0);
    turning_from_the_present(scene(&[others, &[car]].concat()), others.len(), car, 0.06 * side)
}

/// The scenes as one source, with the last eight held out.
pub(super) fn one_source(dataset: &dyn Counted) -> TrainingData<'_> {
    let n_train = dataset.len() - 8;
    let source = TrainingSource {
        weight: 1.0,
        train: (0..n_train).collect(),
        places: vec![0; n_train],
        held_out: (n_train..dataset.len()).collect(),
    };
    TrainingData { dataset, sources: vec![source], state_dim: 3, fingerprint: "scenes".to_owned() }
}

/// A training in `dir` on the processor.
pub(super) fn job(seed: u64, dir: &Path) -> TrainJob<'_> {
    TrainJob { seed: Seed(seed), dir, compute: &CPU, progress: &Silent, time: None }
}

/// Always the history, and nothing else, is observed.
pub(super) const ONLY_PREDICTIVE: TaskWeights = TaskWeights {
    predictive: 1.0,
    goal_conditioned: 0.0,
    agent_conditioned: 0.0,
    ego_conditioned: 0.0,
    windowed: 0.0,
    upsampling: 0.0,
    imputation: 0.0,
};

/// A collator with the scales of the first four scenes.
pub(super) fn collator(dataset: &dyn SceneDataset, parametrization: StateParametrization) -> Collator {
    let scenes: Vec<Scene> = (0..4).map(|idx| dataset.scene(idx).unwrap()).collect();
    tensor::testing::collator(&scenes, parametrization)
}

/// Draws batches of four scenes from these groups.
pub(super) fn draws_of_four<'a>(
    dataset: &'a dyn SceneDataset,
    train: &'a [WeightedGroups],
    collator: &'a Collator,
    masks: &'a MaskSampler,
) -> SceneDraws<'a> {
    SceneDraws {
        collator,
        dataset,
        train,
        held_out: &[],
        masks,
        batch_size: 4,
        with_context: false,
        seed: Seed(3),
        device: &CPU.device,
        ahead: Prefetched::default(),
    }
}
