//! The joint loss has the values that it should have by hand, reaches every parameter, and finds both ways of a fork.

use super::testing::{MadeScenes, ONLY_PREDICTIVE, collator, fork, job, one_source};
use super::*;
use crate::model::{JointFutures, SceneTransformer, SceneTransformerConfig, TrainedSceneTransformer};
use crate::nn::testing::{assert_gradients, scalar};
use crate::nn::{Compute, Params};
use crate::scene::Scene;
use crate::scene::testing::{Drive, scene};
use crate::seed::Seed;
use crate::tensor::{FutureValidity, SceneBatch, SceneTensors, StateParametrization};
use candle_core::{Device, Tensor};

/// Two cars: one drives on, and the other forks.
fn scene_of(idx: usize) -> Scene {
    fork(idx, &[Drive::straight(0.0, -6.0, 0.0, 10.0)])
}

const fn forks(n: usize) -> MadeScenes<fn(usize) -> Scene> {
    MadeScenes(n, scene_of)
}

fn batch(parametrization: StateParametrization, n_rows: usize) -> SceneBatch {
    let scenes: Vec<Scene> = (0..n_rows).map(scene_of).collect();
    let scenes: Vec<&Scene> = scenes.iter().collect();
    collator(&forks(4), parametrization).predictive(&scenes, FutureValidity::Recorded)
}

#[test]
fn the_loss_is_that_of_the_best_future_by_hand() {
    let batch = batch(StateParametrization::Scene, 2);
    // Futures that are the recorded one, moved along the agent's axis by this many meters in every latent state.
    let unit = batch.unit.narrow(2, 0, 1).unwrap().unsqueeze(2).unwrap();
    let moved = |row: usize, meters: f64| {
        let shift = (unit.recip().unwrap() * meters).unwrap();
        let zero = shift.zeros_like().unwrap();
        let shift = Tensor::cat(&[&shift, &zero, &zero], 3).unwrap();
        let x0 = batch.x0.broadcast_add(&shift).unwrap();
        x0.broadcast_mul(&batch.latent.unsqueeze(3).unwrap()).unwrap().narrow(0, row, 1).unwrap()
    };
    let x0 = Tensor::cat(&[moved(0, 1.0), moved(0, 2.0), moved(1, -3.0), moved(1, 0.0)], 0).unwrap();
    let logits = Tensor::new(&[[0.0f32, 3f32.ln()], [0.0, 3f32.ln()]], &Device::Cpu).unwrap();
    let loss = JointLoss::new(&JointFutures { x0, logits }, &batch).unwrap();
    // Row 0: the first is best, √2 - 1, of probability 1/4. Row 1: the second, 0, of probability 3/4.
    assert!((scalar(&loss.regression) - (2f64.sqrt() - 1.0) / 2.0).abs() < 1e-4, "{}", loss.regression);
    assert!((scalar(&loss.mode) - (4f64.ln() + (4.0 / 3.0f64).ln()) / 2.0).abs() < 1e-5, "{}", loss.mode);
}

#[test]
fn rows_without_hidden_states_do_not_count() {
    let whole = batch(StateParametrization::Scene, 2);
    let keep = Tensor::new(&[1f32, 0.0], &Device::Cpu).unwrap().reshape((2, 1, 1)).unwrap();
    let latent = whole.latent.broadcast_mul(&keep).unwrap();
    let partly = SceneBatch::new(SceneTensors { latent, ..SceneTensors::clone(&whole) }).unwrap();
    let x0 = (Tensor::ones((4, 2, 12, 3), candle_core::DType::F32, &Device::Cpu).unwrap() * 0.3).unwrap();
    let logits = Tensor::new(&[[0.5f32, 0.1], [9.0, -9.0]], &Device::Cpu).unwrap();
    let found = JointLoss::new(&JointFutures { x0: x0.clone(), logits: logits.clone() }, &partly).unwrap();
    let alone = JointFutures { x0: x0.narrow(0, 0, 2).unwrap(), logits: logits.narrow(0, 0, 1).unwrap() };
    let expected = JointLoss::new(&alone, &batch(StateParametrization::Scene, 1)).unwrap();
    assert!((scalar(&found.regression) - scalar(&expected.regression)).abs() < 1e-5);
    assert!((scalar(&found.mode) - scalar(&expected.mode)).abs() < 1e-5);
}

fn network() -> SceneTransformerConfig {
    SceneTransformerConfig {
        encoder: "TAM".to_owned(),
        decoder: "TA".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        encoding: 8,
        n_modes: 2,
    }
}

#[test]
fn every_parameter_receives_a_gradient() {
    let mut params = Params::new(&Compute::cpu());
    let network = SceneTransformer::new(&mut params, &network(), 3, StateParametrization::Motion, Seed(1)).unwrap();
    let batch = batch(StateParametrization::Motion, 2);
    let JointLoss { regression, mode } = JointLoss::new(&network.forward(&batch).unwrap(), &batch).unwrap();
    assert_gradients(&(regression + mode).unwrap(), &params, |_| true);
}

/// The loss of driving straight on: the best that a single future can do about a fork.
fn straight_error() -> f64 {
    let (recorded, straight) = (scene_of(0), scene(&[Drive::straight(0.0, 0.0, 0.0, 15.0)]));
    let error = |t: usize| {
        let (a, b) = (recorded.tracks[1].trajectory.get(t).unwrap(), straight.tracks[0].trajectory.get(t).unwrap());
        let (d, angle) = (a.position.distance(b.position), a.heading_rad - b.heading_rad);
        (1.0 + d * d).sqrt() + (1.0 + angle * angle).sqrt() - 2.0
    };
    (4..12).map(error).sum::<f64>() / 16.0
}

#[test]
fn both_ways_of_a_fork_are_found_with_even_odds_and_the_checkpoint_reads_back() {
    let config = BaselineTrainingConfig {
        preset: Preset::Tiny,
        tasks: ONLY_PREDICTIVE,
        steps: Some(250),
        batch_size: Some(4),
        ..BaselineTrainingConfig::default()
    };
    let (dataset, dir) = (forks(40), tempfile::tempdir().unwrap());
    let data = one_source(&dataset);
    let mut training = BaselineTraining { network: network(), ..config.resolve().unwrap() };
    (training.common.fit.learning_rate, training.common.n_eval_scenes) = (5e-3, 8);
    let outcome = train_baseline(&training, &data, job(3, dir.path())).unwrap();
    let last = &outcome.statistics.last().unwrap().evaluation;
    let (error, bound) = (last["held_out_error_of_best"], straight_error());
    assert!(error < 0.4 * bound, "{error}, where driving on straight has {bound}");
    let odds = last["held_out_mode_loss"];
    assert!((odds - 2f64.ln()).abs() < 0.1, "{odds}");
    let read = TrainedSceneTransformer::read(&dir.path().join("model.safetensors"), &Compute::cpu()).unwrap();
    assert_eq!((read.spec, read.fingerprint), (outcome.spec, outcome.fingerprint));
}
