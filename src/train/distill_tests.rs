//! Tuning reaches every parameter, and turns answers that are means into answers that are samples.

use super::testing::{MadeScenes, ONLY_PREDICTIVE, draws_of_four, fork, job, one_source};
use super::*;
use crate::diffusion::sampler::StepGrid;
use crate::diffusion::{NoiseDistribution, NoiseSource, SamplerConfig};
use crate::guidance::{AccelerationLimit, ObjectiveConfig};
use crate::model::{DenoiserSpec, Distillation, NetworkConfig, SceneDenoiser, TrainedDenoiser};
use crate::nn::testing::{assert_gradients, values};
use crate::nn::{Checkpoint, Compute, Params, read_checkpoint};
use crate::scene::Scene;
use crate::seed::Seed;
use crate::tensor::{FutureValidity, MaskSampler, StateParametrization};
use candle_core::Device;
use std::path::Path;

/// A car that bears left or right from the present on.
const FORKS: MadeScenes<fn(usize) -> Scene> = MadeScenes(40, |idx| fork(idx, &[]));

fn data() -> TrainingData<'static> {
    one_source(&FORKS)
}

fn teacher(steps: u64, dir: &Path) -> Checkpoint<DenoiserSpec> {
    let config = DenoiserTrainingConfig {
        preset: Preset::Tiny,
        network: Some(NetworkConfig {
            layers: "TT".to_owned(),
            width: 32,
            n_heads: 2,
            feed_forward: 64,
            encoding: 16,
            latent_periods: [1.0, 100.0],
            path_input: false,
            geometry: None,
        }),
        state_parametrization: Some(StateParametrization::Motion),
        tasks: Some(ONLY_PREDICTIVE),
        steps: Some(steps),
        learning_rate: Some(5e-3),
        batch_size: Some(8),
        n_eval_scenes: Some(8),
        ..DenoiserTrainingConfig::default()
    };
    let noise = NoiseDistribution { p_mean: -0.5, p_std: 1.4 };
    let training = DenoiserTraining { noise, path_loss: 0.0, ..config.resolve().unwrap() };
    train_denoiser(&training, &data(), None, job(3, dir)).unwrap();
    read_checkpoint(&dir.join("model.safetensors"), &Device::Cpu).unwrap()
}

/// Two steps, for data that is decided at far lower noise than traffic.
fn two_steps() -> StepDistillation {
    StepDistillation { grid: StepGrid { sigma_max: Some(20.0), sigma_min: Some(0.8) }, ..Default::default() }
}

fn distillation(steps: u64, method: StepDistillation) -> DistillTraining {
    let config = DistillTrainingConfig { method, tasks: ONLY_PREDICTIVE, steps, ..DistillTrainingConfig::default() };
    let mut training = config.resolve().unwrap();
    training.common.fit.learning_rate = 3e-3;
    training.common.n_eval_scenes = 8;
    training
}

#[test]
fn every_parameter_receives_a_gradient() {
    let dir = tempfile::tempdir().unwrap();
    let teacher = teacher(1, dir.path());
    let (spec, training) = (&teacher.metadata, distillation(60, two_steps()));
    let mut params = Params::new(&Compute::cpu());
    let build = |params: &mut Params| SceneDenoiser::new(params, &spec.network, 3, spec.edm, Seed(1)).unwrap();
    let denoiser = build(&mut params);
    // Layers that begin at zero would hide earlier ones.
    let frozen = build(&mut params.frozen());
    let masks = MaskSampler::new(&training.common.tasks).unwrap();
    let collator = spec.collator();
    let train = [WeightedGroups::single(vec![0, 1, 2, 3])];
    let draws = SceneDraws { batch_size: 8, seed: Seed(2), ..draws_of_four(&FORKS, &train, &collator, &masks) };
    let (denoiser, frozen, training) = (&denoiser, &frozen, &training);
    let steps = &training.method;
    let task = StepDistillationTask { denoiser, frozen, teacher: frozen, steps, training, draws };
    for step in [0, 59] {
        // Nothing here reads a map or attends over agents.
        let loss = task.loss(step).unwrap();
        assert_gradients(&loss, &params, |name| !name.contains("lane"));
    }
}

/// The lateral end of the car in 64 samples of a few evaluations, meters.
fn endings_m(trained: &TrainedDenoiser, sampler: &SamplerConfig) -> Vec<f64> {
    let forked = fork(0, &[]);
    let batch = trained.spec.collator().predictive(&[&forked], FutureValidity::Everything);
    let bound = trained.network.bind(&batch, 64).unwrap();
    let repeated = batch.repeated(64).unwrap();
    let mut noise = NoiseSource::new((0..64).map(Seed).collect());
    let dims = &repeated.x0.dims()[1..];
    let x = sampler.sample(&trained.spec.edm, &bound, dims, &repeated.x0, &mut noise, &mut |_| ()).unwrap();
    values(&repeated.decode(&x).unwrap().narrow(2, 11, 1).unwrap().narrow(3, 1, 1).unwrap())
}

/// The denoiser of [`teacher`], and the result of its distillation.
fn distilled(training: &DistillTraining) -> (TrainedDenoiser, TrainedDenoiser) {
    let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let checkpoint = teacher(400, dirs[0].path());
    let outcome = distill_denoiser(training, &data(), &checkpoint, job(4, dirs[1].path())).unwrap();
    let read = |dir: &Path| TrainedDenoiser::read(&dir.join("model.safetensors"), &Compute::cpu()).unwrap();
    let (denoiser, distilled) = (read(dirs[0].path()), read(dirs[1].path()));
    assert_eq!((&distilled.spec, &distilled.fingerprint), (&outcome.spec, &outcome.fingerprint));
    assert_eq!(distilled.spec.normalizer, denoiser.spec.normalizer);
    assert_eq!(denoiser.spec.distillation, None);
    (denoiser, distilled)
}

/// The number that end on one of both ways, each of which ends some 4 m to the side.
fn n_on_a_way(endings: &[f64]) -> usize {
    let way_m = fork(0, &[]).state(0, 11).unwrap().position.y;
    assert!((3.0..6.0).contains(&way_m), "{way_m}");
    endings.iter().filter(|y| (y.abs() - way_m).abs() < 0.4 * way_m).count()
}

fn assert_both_ways_are_taken(endings: &[f64]) {
    assert!(n_on_a_way(endings) > 40, "{} of 64 on a way: {endings:?}", n_on_a_way(endings));
    let n_left = endings.iter().filter(|y| **y > 0.0).count();
    assert!((16..=48).contains(&n_left), "{n_left} of 64 to the left");
}

#[test]
fn one_large_step_leads_where_many_small_ones_lead() {
    let steps = StepDistillation { n_steps: 1, teacher_steps: 12, ..two_steps() };
    let (denoiser, distilled) = distilled(&distillation(600, steps.clone()));
    let sigmas = steps.sigmas(&denoiser.spec.edm);
    assert_eq!(distilled.spec.distillation, Some(Distillation::Steps { sigmas }));
    let grid = StepGrid { sigma_min: None, ..steps.grid };
    let many = endings_m(&denoiser, &SamplerConfig::heun(20).on(grid));
    let (before, after) = (endings_m(&denoiser, &steps.sampler()), endings_m(&distilled, &steps.sampler()));
    // Equal noise leads to an equal way.
    let n_same = |endings: &[f64]| endings.iter().zip(&many).filter(|(a, b)| (**a - **b).abs() < 1.5).count();
    assert!(n_same(&before) < 20, "without training {} of 64 end where many steps lead", n_same(&before));
    assert!(n_same(&after) >= 50, "{} of 64 end where many steps lead: {after:?} {many:?}", n_same(&after));
    assert_both_ways_are_taken(&after);
}

fn calm(weight: f64) -> ObjectiveConfig {
    ObjectiveConfig::new(weight, AccelerationLimit { limit_mps2: 0.5 })
}

#[test]
fn objectives_shape_where_the_steps_end() {
    let dir = tempfile::tempdir().unwrap();
    let checkpoint = teacher(200, dir.path());
    let final_cost = |weight: f64| {
        let mut training = distillation(120, two_steps());
        training.objectives = vec![calm(weight)];
        let dir = tempfile::tempdir().unwrap();
        let outcome = distill_denoiser(&training, &data(), &checkpoint, job(4, dir.path())).unwrap();
        outcome.statistics.last().unwrap().evaluation["held_out_cost_of_acceleration_limit"]
    };
    // Steps from a teacher that has barely learned jump about.
    let (free, limited) = (final_cost(1e-6), final_cost(1.0));
    assert!(free > 0.1 && limited < 0.3 * free, "{free} without the objective, {limited} with it");
}
