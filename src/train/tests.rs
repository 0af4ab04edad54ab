//! Training learns, resumes to the same weights, and says what is wrong with its input.

use super::data_parallel_tests::assert_parts_agree;
use super::*;
use crate::diffusion::{NoiseDistribution, NoiseSource};
use crate::guidance::{AccelerationLimit, AgentSelector, ObjectiveConfig, SpeedLimit};
use crate::model::{DenoiserSpec, GeometryConfig, NetworkConfig, SceneDenoiser, TrainedDenoiser};
use crate::nn::{Checkpoint, Compute, Params, read_checkpoint};
use crate::progress::Silent;
use crate::scene::Scene;
use crate::scene::testing::{Drive, scene};
use crate::seed::Seed;
use crate::tensor::{Collator, MaskSampler, StateParametrization};
use candle_core::{Device, Tensor};
use std::path::Path;

/// Two cars each: one drives on, one turns at a speed that shows in its history.
struct Arcs(Vec<Scene>);

impl Arcs {
    fn new(n: usize) -> Self {
        let mut rng = Seed(11).rng();
        let one = |_| {
            let speed_mps = 6.0 + 6.0 * rng.uniform();
            let curvature_1pm = 0.05;
            scene(&[
                Drive::straight(0.0, 0.0, 0.0, 10.0),
                Drive { x: 10.0, y: 4.0, heading_rad: 0.2, speed_mps, curvature_1pm },
            ])
        };
        Self((0..n).map(one).collect())
    }
}

impl SceneDataset for Arcs {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
        self.0.get(idx).cloned().ok_or_else(|| format!("no scene {idx}").into())
    }
}

fn speed_limit(weight: f64) -> ObjectiveConfig {
    let agents = AgentSelector::default();
    ObjectiveConfig::SpeedLimit(SpeedLimit { weight, agents, limit_mps: 8.0, tolerance_mps: 1.0 })
}

fn training(steps: u64) -> DenoiserTraining {
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
        noise: Some(NoiseDistribution { p_mean: -0.5, p_std: 1.4 }),
        network: Some(network),
        steps: Some(steps),
        learning_rate: Some(5e-3),
        batch_size: Some(4),
        evaluate_every: Some(20),
        save_every: Some(10),
        n_eval_scenes: Some(8),
        ..DenoiserTrainingConfig::default()
    };
    config.resolve().unwrap()
}

fn train(
    dataset: &dyn SceneDataset,
    training: &DenoiserTraining,
    dir: &Path,
) -> Result<TrainOutcome<DenoiserSpec>, Error> {
    train_from(None, dataset, training, dir)
}

fn train_from(
    start: Option<&Checkpoint<DenoiserSpec>>,
    dataset: &dyn SceneDataset,
    training: &DenoiserTraining,
    dir: &Path,
) -> Result<TrainOutcome<DenoiserSpec>, Error> {
    let n = dataset.len();
    let data = TrainingData {
        dataset,
        sources: vec![TrainingSource {
            weight: 1.0,
            train: (0..n - 8).collect(),
            places: vec![0; n - 8],
            held_out: (n - 8..n).collect(),
        }],
        state_dim: 3,
        fingerprint: "scenes".to_owned(),
    };
    let job = TrainJob { seed: Seed(3), dir, compute: &Compute::cpu(), progress: &Silent, exchange: &Alone };
    train_denoiser(training, &data, start, job).map(Option::unwrap)
}

#[test]
fn the_held_out_loss_falls_and_the_checkpoint_reads_back() {
    let dir = tempfile::tempdir().unwrap();
    let outcome = train(&Arcs::new(40), &training(400), dir.path()).unwrap();
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
        // Nobody was recorded to turn that hard, but what is left of noise looks like it.
        training.objectives = vec![ObjectiveConfig::AccelerationLimit(AccelerationLimit {
            weight,
            agents: AgentSelector::default(),
            limit_mps2: 8.0,
            tolerance_mps2: 1.0,
        })];
        let dir = tempfile::tempdir().unwrap();
        let outcome = train(&Arcs::new(24), &training, dir.path()).unwrap();
        outcome.statistics.last().unwrap().evaluation["held_out_cost_of_acceleration_limit"]
    };
    let (free, limited) = (final_cost(1e-6), final_cost(10.0));
    assert!(free > 0.3 && limited < 0.7 * free, "{free} without the objective, {limited} with it");
}

#[test]
fn the_same_seed_gives_the_same_checkpoint_and_an_interruption_changes_nothing() {
    let dataset = Arcs::new(20);
    let (whole, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let expected = train(&dataset, &training(25), whole.path()).unwrap();
    // Training fails at the first scene that cannot be loaded, after some steps have been saved.
    struct Failing<'a>(&'a Arcs, std::sync::atomic::AtomicUsize);
    impl SceneDataset for Failing<'_> {
        fn len(&self) -> usize {
            self.0.len()
        }
        fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
            match self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed) {
                80.. => Err("gone".into()),
                _ => self.0.scene(idx),
            }
        }
    }
    assert!(train(&Failing(&dataset, 0.into()), &training(25), killed.path()).is_err());
    assert!(killed.path().join("state.safetensors").exists() && !killed.path().join("model.safetensors").exists());
    let resumed = train(&dataset, &training(25), killed.path()).unwrap();
    assert_eq!(resumed.fingerprint, expected.fingerprint);
    assert_eq!(resumed.statistics, expected.statistics);
}

/// Draws batches of four scenes from these groups.
fn draws_of_four<'a>(
    dataset: &'a Arcs,
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
        device: &Device::Cpu,
        ahead: Prefetched::default(),
    }
}

#[test]
fn a_batch_made_in_advance_is_the_one_that_would_be_drawn() {
    let (dir, dataset) = (tempfile::tempdir().unwrap(), Arcs::new(20));
    let training = training(1);
    let spec = train(&dataset, &training, dir.path()).unwrap().spec;
    let (collator, masks) = (spec.collator(), MaskSampler::new(&training.common.tasks).unwrap());
    let train = [WeightedGroups::single((0..10).collect())];
    let draws = || draws_of_four(&dataset, &train, &collator, &masks);
    let values_of = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    let values = |drawn: DrawnBatch| {
        let of = values_of;
        (of(&drawn.batch.x0), of(&drawn.batch.latent), of(&drawn.batch.lanes), drawn.seeds)
    };
    let ahead = draws();
    // Ten scenes in batches of four: step 2 takes the end of one epoch and the beginning of the next.
    let part = |step: u64, rows: std::ops::Range<usize>| BatchPart { step, rows };
    for (prepared, asked) in [
        (part(2, 0..4), part(2, 0..4)),
        (part(3, 0..4), part(7, 0..4)),
        (part(8, 0..4), part(2, 0..4)),
        (part(2, 1..3), part(2, 0..4)),
        (part(2, 1..3), part(2, 1..3)),
    ] {
        ahead.prepare(&prepared).unwrap();
        let expected = values(draws().training_batch(&asked).unwrap());
        assert!(values(ahead.training_batch(&asked).unwrap()) == expected, "{prepared:?} {asked:?}");
    }
    // The rows of a part are drawn as they are among all.
    let (whole, some) =
        (draws().training_batch(&part(5, 0..4)).unwrap(), draws().training_batch(&part(5, 1..3)).unwrap());
    assert_eq!(whole.seeds[1..3], some.seeds);
    assert_eq!(values_of(&whole.batch.x0.narrow(0, 1, 2).unwrap()), values_of(&some.batch.x0));
}

#[test]
fn parts_of_a_batch_add_up_to_its_gradient() {
    let (dir, dataset) = (tempfile::tempdir().unwrap(), Arcs::new(20));
    // Half of the rows or so are at so little noise that the objective counts.
    let mut training = DenoiserTraining { objectives_below_sigma: 0.6, ..training(1) };
    training.objectives = vec![speed_limit(3.0)];
    let spec = train(&dataset, &training, dir.path()).unwrap().spec;
    let mut params = Params::new(&Compute::cpu());
    let denoiser = &SceneDenoiser::new(&mut params, &spec.network, 3, spec.edm, Seed(5)).unwrap();
    let (collator, masks) = (spec.collator(), MaskSampler::new(&training.common.tasks).unwrap());
    let train = [WeightedGroups::single((0..12).collect())];
    let draws = SceneDraws { batch_size: 6, with_context: true, ..draws_of_four(&dataset, &train, &collator, &masks) };
    let task = DenoisingTask { denoiser, frozen: denoiser, training: &training, draws };
    let n_counted =
        |step| -> Vec<f64> { (0..4).map(|i| task.divisors(&BatchPart::of_batch(step, 6, i, 4)).unwrap()[1]).collect() };
    let counted: Vec<Vec<f64>> = (0..4).map(n_counted).collect();
    assert!(counted.iter().any(|parts| parts.contains(&0.0) && parts.iter().sum::<f64>() > 0.0), "{counted:?}");
    (0..4).for_each(|step| assert_parts_agree(&params, &task, step));
}

/// A network that always answers 0 leaves c_skip(σ) x as the estimate, so that the loss follows from the draws alone (EDM, table 1).
#[test]
fn the_loss_is_the_weighted_error_at_the_noise_levels_that_were_drawn() {
    let (dir, dataset) = (tempfile::tempdir().unwrap(), Arcs::new(20));
    let training = DenoiserTraining { path_loss: 0.0, ..training(1) };
    let spec = train(&dataset, &training, dir.path()).unwrap().spec;
    let mut params = Params::new(&Compute::cpu());
    let denoiser = SceneDenoiser::new(&mut params, &spec.network, 3, spec.edm, Seed(5)).unwrap();
    let zeros = params.tensors().into_iter().map(|(name, tensor)| (name, tensor.zeros_like().unwrap()));
    params.load(&zeros.collect()).unwrap();
    let (collator, masks) = (spec.collator(), MaskSampler::new(&training.common.tasks).unwrap());
    let train = [WeightedGroups::single((0..12).collect())];
    let draws = draws_of_four(&dataset, &train, &collator, &masks);
    let task = DenoisingTask { denoiser: &denoiser, frozen: &denoiser, training: &training, draws };

    let DrawnBatch { batch, seeds, mut rngs, .. } = task.draws.training_batch(&BatchPart::whole(7, 4)).unwrap();
    let values = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    let (x0, noise) = (values(&batch.x0), values(&NoiseSource::new(seeds).draw_like(&batch.x0).unwrap()));
    let (scored, latent) = (values(&batch.scored), values(&batch.latent));
    let sigmas: Vec<f64> = rngs.iter_mut().map(|rng| training.noise.draw(rng)).collect();
    let (variance_of_data, n_of_row) = (0.25, x0.len() / sigmas.len());
    let mut sum = 0.0;
    for (i, (x0, noise)) in x0.iter().zip(&noise).map(|(x0, noise)| (f64::from(*x0), f64::from(*noise))).enumerate() {
        let sigma = sigmas[i / n_of_row];
        let total = sigma * sigma + variance_of_data;
        let estimate = variance_of_data / total * (x0 + sigma * noise) * f64::from(latent[i / 3]);
        sum += total / (sigma * sigma * variance_of_data) * (estimate - x0).powi(2) * f64::from(scored[i / 3]);
    }
    let expected = sum / (3.0 * scored.iter().copied().map(f64::from).sum::<f64>());
    let loss = f64::from(task.loss(&BatchPart::whole(7, 4), None).unwrap().to_scalar::<f32>().unwrap());
    assert!((loss / expected - 1.0).abs() < 1e-4, "{loss}, expected {expected} at {sigmas:?}");
}

#[test]
fn training_can_start_from_a_checkpoint() {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let early = |outcome: &TrainOutcome<DenoiserSpec>| {
        let mut losses = outcome.statistics.iter().filter_map(|line| line.evaluation.get("held_out_loss_at_sigma_0.8"));
        *losses.next().unwrap()
    };
    let cold = train(&Arcs::new(40), &training(100), first.path()).unwrap();
    let path = first.path().join("model.safetensors");
    let start = read_checkpoint::<DenoiserSpec>(&path, &Device::Cpu).unwrap();
    let warm = train_from(Some(&start), &Arcs::new(48), &training(20), second.path()).unwrap();
    assert!(early(&warm) < 0.8 * early(&cold), "{} after {}", early(&warm), early(&cold));
    assert_eq!(warm.spec.normalizer, cold.spec.normalizer);
    let mut other = training(20);
    other.network.layers = "TAT".to_owned();
    let error = train_from(Some(&start), &Arcs::new(40), &other, second.path()).unwrap_err().to_string();
    assert!(error.contains("another network"), "{error}");
}

#[test]
fn settings_that_make_no_sense_are_named() {
    for (config, name) in [
        (DenoiserTrainingConfig { learning_rate: Some(-1.0), ..Default::default() }, "learning_rate"),
        (DenoiserTrainingConfig { batch_size: Some(0), ..Default::default() }, "batch_size"),
        (DenoiserTrainingConfig { ema_decay: Some(1.0), ..Default::default() }, "ema_decay"),
        (DenoiserTrainingConfig { objectives_below_sigma: Some(0.0), ..Default::default() }, "objectives_below_sigma"),
        (
            DenoiserTrainingConfig { objectives: vec![speed_limit(-1.0)], ..Default::default() },
            "train.denoiser.objectives.0.weight is -1",
        ),
    ] {
        let message = config.resolve().unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn groups_count_the_same_however_many_scenes_they_have() {
    let (dir, dataset) = (tempfile::tempdir().unwrap(), Arcs::new(18));
    let data = TrainingData {
        dataset: &dataset,
        sources: vec![TrainingSource {
            weight: 1.0,
            train: (0..10).collect(),
            places: vec![4, 4, 4, 4, 4, 4, 4, 4, 9, 9],
            held_out: Vec::new(),
        }],
        state_dim: 3,
        fingerprint: String::new(),
    };
    assert_eq!(data.groups(Balance::Scenes), [WeightedGroups::single((0..10).collect())]);
    let places = data.groups(Balance::Places);
    assert_eq!(places[0].groups, [(0..8).collect::<Vec<_>>(), vec![8, 9]]);
    // Every second row is of the small place, whose two scenes take turns.
    let spec = train(&dataset, &training(1), dir.path()).unwrap().spec;
    let masks = MaskSampler::new(&training(1).common.tasks).unwrap();
    let collator = spec.collator();
    let draws = draws_of_four(&dataset, &places, &collator, &masks);
    let drawn: Vec<usize> = (0..4).flat_map(|step| draws.batch_indices(step)).collect();
    let (large, small): (Vec<_>, Vec<_>) = drawn.chunks(2).map(|pair| (pair[0], pair[1])).unzip();
    let sorted = |mut indices: Vec<usize>| {
        indices.sort_unstable();
        indices
    };
    assert_eq!(sorted(large), (0..8).collect::<Vec<_>>());
    assert!(small.chunks(2).all(|epoch| sorted(epoch.to_vec()) == [8, 9]), "{small:?}");
}

#[test]
fn draws_follow_the_weights_of_sources() {
    let (dir, dataset) = (tempfile::tempdir().unwrap(), Arcs::new(18));
    let source = |weight, groups: &[(usize, usize)]| WeightedGroups {
        weight,
        groups: groups.iter().map(|(first, end)| (*first..*end).collect()).collect(),
    };
    // Half of the draws, three eighths and one eighth, whatever the number of scenes; the second source has two places.
    let sources = [source(4.0, &[(0, 2)]), source(3.0, &[(2, 3), (3, 10)]), source(1.0, &[(10, 18)])];
    let training = training(1);
    let spec = train(&dataset, &training, dir.path()).unwrap().spec;
    let (collator, masks) = (spec.collator(), MaskSampler::new(&training.common.tasks).unwrap());
    let draws = draws_of_four(&dataset, &sources, &collator, &masks);
    let drawn: Vec<usize> = (0..32).flat_map(|step| draws.batch_indices(step)).collect();
    let n_of =
        |drawn: &[usize], scenes: std::ops::Range<usize>| drawn.iter().filter(|idx| scenes.contains(*idx)).count();
    assert_eq!([n_of(&drawn, 0..2), n_of(&drawn, 2..10), n_of(&drawn, 10..18)], [64, 48, 16]);
    assert_eq!(n_of(&drawn, 2..3), 24, "places of a source count the same");
    // Every stretch of the training is mixed alike, and every scene of a source has its turn.
    assert!(drawn.chunks(8).all(|stretch| n_of(stretch, 0..2) == 4), "{drawn:?}");
    assert!((10..18).all(|idx| n_of(&drawn, idx..idx + 1) == 2), "{drawn:?}");
    // A resumed training asks for later steps alone.
    assert_eq!(draws_of_four(&dataset, &sources, &collator, &masks).batch_indices(31), drawn[124..]);
}

#[test]
fn scales_and_held_out_scenes_are_of_all_sources_by_their_weights() {
    let dataset = Arcs::new(40);
    let source = |weight, from: usize, n: usize| TrainingSource {
        weight,
        train: (from..from + n).collect(),
        places: vec![0; n],
        held_out: (from + n..from + n + 4).collect(),
    };
    let data = TrainingData {
        dataset: &dataset,
        sources: vec![source(3.0, 0, 20), source(1.0, 24, 4)],
        state_dim: 3,
        fingerprint: String::new(),
    };
    assert_eq!((data.n_train(), data.n_held_out()), (24, 8));
    let chosen = data.chosen_held_out(4, Seed(1));
    assert_eq!(chosen.iter().filter(|idx| (20..24).contains(*idx)).count(), 3);
    assert_eq!(chosen.iter().filter(|idx| (28..32).contains(*idx)).count(), 1);
}

#[test]
fn geometry_that_makes_no_sense_is_named() {
    let geometric = |geometry: GeometryConfig| NetworkConfig { geometry: Some(geometry), ..NetworkConfig::default() };
    let with =
        |geometry: GeometryConfig| DenoiserTrainingConfig { network: Some(geometric(geometry)), ..Default::default() };
    let patch = with(GeometryConfig { patch: 0, ..GeometryConfig::default() });
    let lanes = with(GeometryConfig { n_lanes: 1_000_000, ..GeometryConfig::default() });
    let residual = DenoiserTrainingConfig {
        state_parametrization: Some(StateParametrization::Residual),
        ..with(GeometryConfig::default())
    };
    for (config, expected) in [
        (patch, "train.denoiser.network.geometry.patch is 0, expected 1 to 100"),
        (lanes, "train.denoiser.network.geometry.n_lanes is 1000000, expected 1 to 200"),
        (residual, "train.denoiser.network.geometry needs state_parametrization"),
    ] {
        let message = config.resolve().unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    // A preset's own geometry is left out where it does not fit, and its encodings stay within the network's width.
    let other = DenoiserTrainingConfig {
        preset: Preset::Small,
        state_parametrization: Some(StateParametrization::Residual),
        ..Default::default()
    };
    let network = other.resolve().unwrap().network;
    assert_eq!((network.geometry, network.encoding), (None, network.width));
}
