//! A denoiser learns, resumes to the same weights and starts from a checkpoint, and its loss is EDM's.

use super::testing::{Counted, MadeScenes, arcs, collator, draws_of_four, job, one_source};
use super::*;
use crate::diffusion::{NoiseDistribution, NoiseSource};
use crate::guidance::{AccelerationLimit, ObjectiveConfig};
use crate::model::{DenoiserSpec, NetworkConfig, SceneDenoiser, TrainedDenoiser};
use crate::nn::testing::{scalar, values};
use crate::nn::{Checkpoint, Compute, Params, read_checkpoint};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::seed::Seed;
use crate::tensor::MaskSampler;
use candle_core::Device;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

pub(super) fn training(steps: u64) -> DenoiserTraining {
    let network = NetworkConfig {
        layers: "TA".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        encoding: 8,
        ..NetworkConfig::default()
    };
    let config = DenoiserTrainingConfig {
        preset: Preset::Tiny,
        network: Some(network),
        steps: Some(steps),
        learning_rate: Some(5e-3),
        batch_size: Some(4),
        evaluate_every: Some(20),
        save_every: Some(10),
        n_eval_scenes: Some(8),
        ..DenoiserTrainingConfig::default()
    };
    let noise = NoiseDistribution { p_mean: -0.5, p_std: 1.4 };
    DenoiserTraining { noise, ..config.resolve().unwrap() }
}

type Outcome = Result<TrainOutcome<DenoiserSpec>, Error>;

fn train(dataset: &dyn Counted, training: &DenoiserTraining, dir: &Path) -> Outcome {
    train_from(None, dataset, training, dir)
}

fn train_from(
    start: Option<&Checkpoint<DenoiserSpec>>,
    dataset: &dyn Counted,
    training: &DenoiserTraining,
    dir: &Path,
) -> Outcome {
    train_denoiser(training, &one_source(dataset), start, job(3, dir))
}

#[test]
fn the_held_out_loss_falls_and_the_checkpoint_reads_back() {
    let dir = tempfile::tempdir().unwrap();
    let outcome = train(&arcs(40), &training(400), dir.path()).unwrap();
    let evaluations: Vec<_> = outcome.statistics.iter().filter(|line| !line.evaluation.is_empty()).collect();
    let loss = |line: &FitStatistics| line.evaluation["held_out_loss_at_sigma_0.8"];
    let (first, last) = (loss(evaluations[0]), loss(evaluations[evaluations.len() - 1]));
    assert!(last < 0.6 * first, "from {first} to {last}");
    let read = TrainedDenoiser::read(&dir.path().join("model.safetensors"), &Compute::cpu()).unwrap();
    assert_eq!((read.spec, read.fingerprint), (outcome.spec, outcome.fingerprint));
}

#[test]
fn objectives_shape_clean_estimates() {
    let final_cost = |weight: f64| {
        let mut training = training(200);
        // No recorded agent turns that hard, but residual noise looks like it.
        training.objectives = vec![ObjectiveConfig::new(weight, AccelerationLimit { limit_mps2: 8.0 })];
        let dir = tempfile::tempdir().unwrap();
        let outcome = train(&arcs(24), &training, dir.path()).unwrap();
        outcome.statistics.last().unwrap().evaluation["held_out_cost_of_acceleration_limit"]
    };
    let (free, limited) = (final_cost(1e-6), final_cost(10.0));
    assert!(free > 0.3 && limited < 0.7 * free, "{free} without the objective, {limited} with it");
}

#[test]
fn the_same_seed_gives_the_same_checkpoint_and_an_interruption_changes_nothing() {
    let dataset = arcs(20);
    let (whole, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let expected = train(&dataset, &training(25), whole.path()).unwrap();
    // Training fails at the first scene that cannot be loaded: ever later, until some steps have been saved.
    struct Failing<'a>(&'a dyn Counted, usize, AtomicUsize);
    impl Counted for Failing<'_> {
        fn len(&self) -> usize {
            self.0.len()
        }
    }
    impl SceneDataset for Failing<'_> {
        fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
            match self.2.fetch_add(1, Ordering::Relaxed) {
                n if n >= self.1 => Err("gone".into()),
                _ => self.0.scene(idx),
            }
        }
    }
    let is_saved = || killed.path().join("state.safetensors").exists();
    for n_scenes in (60..).step_by(10).take_while(|_| !is_saved()) {
        assert!(train(&Failing(&dataset, n_scenes, 0.into()), &training(25), killed.path()).is_err());
    }
    assert!(!killed.path().join("model.safetensors").exists());
    let resumed = train(&dataset, &training(25), killed.path()).unwrap();
    assert_eq!(resumed.fingerprint, expected.fingerprint);
    assert_eq!(resumed.statistics, expected.statistics);
}

/// If the network returns 0, the estimate is c_skip(σ) x, and the loss follows from the draws alone (EDM, table 1).
#[test]
fn the_loss_is_the_weighted_error_at_the_noise_levels_that_were_drawn() {
    let dataset = arcs(20);
    let training = DenoiserTraining { path_loss: 0.0, ..training(1) };
    let mut params = Params::new(&Compute::cpu());
    let denoiser = SceneDenoiser::new(&mut params, &training.network, 3, training.edm, Seed(5)).unwrap();
    let zeros = params.tensors().into_iter().map(|(name, tensor)| (name, tensor.zeros_like().unwrap()));
    params.load(&zeros.collect()).unwrap();
    let (collator, masks) =
        (collator(&dataset, training.parametrization), MaskSampler::new(&training.common.tasks).unwrap());
    let train = [WeightedGroups::single((0..12).collect())];
    let draws = draws_of_four(&dataset, &train, &collator, &masks);
    let task = DenoisingTask { denoiser: &denoiser, frozen: &denoiser, training: &training, draws, sampling: None };

    let DrawnBatch { batch, seeds, mut rngs, .. } = task.draws.training_batch(7).unwrap();
    let (x0, noise) = (values(&batch.x0), values(&NoiseSource::new(seeds).draw_like(&batch.x0).unwrap()));
    let (scored, latent) = (values(&batch.scored), values(&batch.latent));
    let sigmas: Vec<f64> = rngs.iter_mut().map(|rng| training.noise.draw(rng)).collect();
    let (variance_of_data, n_of_row) = (0.25, x0.len() / sigmas.len());
    let mut sum = 0.0;
    for (i, (x0, noise)) in x0.iter().zip(&noise).enumerate() {
        let sigma = sigmas[i / n_of_row];
        let total = sigma * sigma + variance_of_data;
        let estimate = variance_of_data / total * (x0 + sigma * noise) * latent[i / 3];
        sum += total / (sigma * sigma * variance_of_data) * (estimate - x0).powi(2) * scored[i / 3];
    }
    let expected = sum / (3.0 * scored.iter().sum::<f64>());
    let loss = scalar(&task.loss(7).unwrap());
    assert!((loss / expected - 1.0).abs() < 1e-4, "{loss}, expected {expected} at {sigmas:?}");
}

#[test]
fn training_can_start_from_a_checkpoint() {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let early = |outcome: &TrainOutcome<DenoiserSpec>| {
        let mut losses = outcome.statistics.iter().filter_map(|line| line.evaluation.get("held_out_loss_at_sigma_0.8"));
        *losses.next().unwrap()
    };
    let cold = train(&arcs(40), &training(100), first.path()).unwrap();
    let path = first.path().join("model.safetensors");
    let start = read_checkpoint::<DenoiserSpec>(&path, &Device::Cpu).unwrap();
    let warm = train_from(Some(&start), &arcs(48), &training(20), second.path()).unwrap();
    assert!(early(&warm) < 0.8 * early(&cold), "{} after {}", early(&warm), early(&cold));
    let scales = |outcome: &TrainOutcome<DenoiserSpec>| outcome.spec.normalizer.scene_units();
    assert_eq!(scales(&warm), scales(&cold));
    assert_ne!(warm.spec.normalizer.motion_covariance, cold.spec.normalizer.motion_covariance);
    let own = DenoiserTraining { scales: Scales::Checkpoint, ..training(1) };
    let alike = train_from(Some(&start), &arcs(48), &own, second.path()).unwrap();
    assert_eq!(alike.spec.normalizer, cold.spec.normalizer);
    // A training that only makes it worse ends with the weights it started from.
    let third = tempfile::tempdir().unwrap();
    let mut spoiling = training(20);
    spoiling.common.fit.learning_rate = 5.0;
    train_from(Some(&start), &arcs(48), &spoiling, third.path()).unwrap();
    let end = read_checkpoint::<DenoiserSpec>(&third.path().join("model.safetensors"), &Device::Cpu).unwrap();
    for (name, tensor) in &start.tensors {
        let values = |tensor: &candle_core::Tensor| tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(values(tensor), values(&end.tensors[name]), "{name}");
    }
    let mut other = training(20);
    other.network.layers = "TAT".to_owned();
    let error = train_from(Some(&start), &arcs(40), &other, second.path()).unwrap_err().to_string();
    assert!(error.contains("another network"), "{error}");
}

#[test]
fn few_scenes_to_take_the_scales_of_motion_from_are_a_warning() {
    #[derive(Default)]
    struct Heard(Mutex<Vec<String>>);
    impl Progress for Heard {
        fn warn(&self, message: &str) {
            self.0.lock().unwrap().push(message.to_owned());
        }
    }
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    train(&arcs(40), &training(1), first.path()).unwrap();
    let start = read_checkpoint::<DenoiserSpec>(&first.path().join("model.safetensors"), &Device::Cpu).unwrap();
    let warnings = |start: Option<&Checkpoint<DenoiserSpec>>, n_scenes: usize| {
        let heard = Heard::default();
        let job = TrainJob { progress: &heard, ..job(3, second.path()) };
        let (scenes, steps) = (arcs(n_scenes), training(1));
        train_denoiser(&steps, &one_source(&scenes), start, job).unwrap();
        let of_scenes =
            heard.0.into_inner().unwrap().into_iter().filter(|warning| warning.contains("expected at least"));
        of_scenes.collect::<Vec<_>>()
    };
    let few = warnings(Some(&start), 48);
    assert!(few.len() == 1 && few[0].contains("trained further on 40 scenes"), "{few:?}");
    assert!(warnings(Some(&start), 80).is_empty() && warnings(None, 48).is_empty());
}

#[test]
fn a_checkpoint_takes_the_scales_of_other_scenes_without_training() {
    let [first, second, third] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    train(&arcs(40), &training(10), first.path()).unwrap();
    let read = |dir: &Path| read_checkpoint::<DenoiserSpec>(&dir.join("model.safetensors"), &Device::Cpu).unwrap();
    let start = read(first.path());
    let further = train_from(Some(&start), &arcs(48), &training(1), second.path()).unwrap();
    let calibrated = |dataset: &dyn Counted, dir: &Path| calibrate_denoiser(&start, &one_source(dataset), job(3, dir));
    let fingerprint = calibrated(&arcs(48), third.path()).unwrap();
    let found = read(third.path());
    assert_eq!(found.fingerprint, fingerprint);
    assert_ne!(found.metadata, start.metadata);
    assert_eq!(found.metadata, DenoiserSpec { normalizer: further.spec.normalizer, ..start.metadata.clone() });
    for (name, tensor) in &start.tensors {
        let values = |tensor: &candle_core::Tensor| tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(values(tensor), values(&found.tensors[name]), "{name}");
    }
    // From its own scenes it takes what it has.
    calibrated(&arcs(40), third.path()).unwrap();
    assert_eq!(read(third.path()).metadata, start.metadata);
    let mut short = arcs(1).scene(0).unwrap();
    short.n_timesteps -= 1;
    let error = calibrated(&MadeScenes(40, |_| short.clone()), third.path()).unwrap_err().to_string();
    assert!(error.contains("calibrate on scenes of the same length"), "{error}");
}
