//! Gradients reach every parameter, padding never leaks, and the order of agents does not matter.

use super::*;
use crate::diffusion::{Denoiser, Edm};
use crate::nn::testing::{assert_gradients, values, worst};
use crate::nn::{Compute, Params, Scope};
use crate::scene::Scene;
use crate::scene::testing::{Drive, scene};
use crate::seed::Seed;
use crate::tensor::testing::collator;
use crate::tensor::{FutureValidity, SceneBatch, SceneTensors, StateParametrization};
use candle_core::{Device, Tensor};

fn config() -> NetworkConfig {
    NetworkConfig {
        layers: "TAM AT".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        encoding: 8,
        latent_periods: [1.0, 100.0],
        path_input: true,
        geometry: None,
    }
}

/// Cars one behind the other, each faster than the one before it, and on a sharper bend.
pub(super) fn drives(n: usize) -> Vec<Drive> {
    let drive = |i: usize| Drive {
        x: 6.0 * i as f64,
        y: 2.0 - i as f64,
        heading_rad: 0.1 * i as f64,
        speed_mps: 9.0 + i as f64,
        curvature_1pm: 0.02 * i as f64,
    };
    (0..n).map(drive).collect()
}

fn cars(n: usize) -> Scene {
    scene(&drives(n))
}

fn collate(scenes: &[&Scene]) -> SceneBatch {
    collator([&cars(3)], StateParametrization::Motion).predictive(scenes, FutureValidity::Recorded)
}

/// Deterministic noisy states of one scene's shape.
pub(super) fn noisy(batch: &SceneBatch, seed: u64) -> Tensor {
    let mut rng = Seed(seed).rng();
    let dims = batch.x0.dims().to_vec();
    let draws: Vec<f32> = (0..batch.x0.elem_count()).map(|_| rng.normal() as f32).collect();
    let noise = Tensor::from_vec(draws, dims, &Device::Cpu).unwrap();
    (&batch.x0 + noise).unwrap().broadcast_mul(&batch.latent.unsqueeze(3).unwrap()).unwrap()
}

pub(super) fn run(denoiser: &SceneDenoiser, batch: &SceneBatch, x: &Tensor, sigmas: &[f32]) -> Tensor {
    let sigma = Tensor::new(sigmas, &Device::Cpu).unwrap();
    denoiser.bind(batch, 1).unwrap().denoise(x, &sigma).unwrap()
}

/// Fails unless the loss on the states of `batch` reaches every parameter of such a network.
pub(super) fn reaches_every_parameter(config: &NetworkConfig, batch: &SceneBatch) {
    let mut params = Params::new(&Compute::cpu());
    let denoiser = SceneDenoiser::new(&mut params, config, 3, Edm::default(), Seed(1)).unwrap();
    let x0_hat = run(&denoiser, batch, &noisy(batch, 2), &[0.4]);
    let loss = (x0_hat - &batch.x0).unwrap().sqr().unwrap().sum_all().unwrap();
    assert_gradients(&loss, &params, |_| true);
}

/// What holds for the scenes of any network: those of `cars` with so many agents, in batches of `collate`.
pub(super) struct Scenes {
    pub(super) config: NetworkConfig,
    pub(super) cars: fn(usize) -> Scene,
    pub(super) collate: fn(&[&Scene]) -> SceneBatch,
}

impl Scenes {
    fn denoiser(&self) -> SceneDenoiser {
        SceneDenoiser::new(&mut Params::new(&Compute::cpu()), &self.config, 3, Edm::default(), Seed(1)).unwrap()
    }

    /// A row is the same alone and among larger scenes.
    pub(super) fn do_not_mix(&self) {
        let (denoiser, small, large) = (self.denoiser(), (self.cars)(2), (self.cars)(5));
        let (alone, together) = ((self.collate)(&[&small]), (self.collate)(&[&small, &large]));
        let x = noisy(&alone, 3);
        let padded = x.pad_with_zeros(1, 0, 3).unwrap();
        let both = Tensor::cat(&[&padded, &noisy(&(self.collate)(&[&large]), 4)], 0).unwrap();
        let expected = run(&denoiser, &alone, &x, &[0.7]);
        let found = run(&denoiser, &together, &both, &[0.7, 2.0]).get(0).unwrap();
        assert!(worst(&found.narrow(0, 0, 2).unwrap(), &expected.get(0).unwrap()) < 1e-5);
        assert!(values(&found.narrow(0, 2, 3).unwrap()).iter().all(|x| *x == 0.0));
    }

    /// Samples of one scene share its encoding.
    pub(super) fn are_encoded_once(&self) {
        let denoiser = self.denoiser();
        let batch = (self.collate)(&[&(self.cars)(3), &(self.cars)(2)]);
        let repeated = batch.repeated(2).unwrap();
        let x = noisy(&repeated, 5);
        let sigma = Tensor::new(&[0.5f32, 0.5, 0.9, 0.9], &Device::Cpu).unwrap();
        let shared = denoiser.bind(&batch, 2).unwrap().denoise(&x, &sigma).unwrap();
        let apart = denoiser.bind(&repeated, 1).unwrap().denoise(&x, &sigma).unwrap();
        assert!(worst(&shared, &apart) < 1e-5);
    }

    /// The order of agents does not matter.
    pub(super) fn have_no_order(&self) {
        let (denoiser, scene) = (self.denoiser(), (self.cars)(3));
        let mut swapped = scene.clone();
        swapped.tracks.swap(1, 2);
        let (a, b) = ((self.collate)(&[&scene]), (self.collate)(&[&swapped]));
        let x = noisy(&a, 6);
        let order = Tensor::new(&[0u32, 2, 1], &Device::Cpu).unwrap();
        let found = run(&denoiser, &b, &x.index_select(&order, 1).unwrap(), &[0.4]);
        let expected = run(&denoiser, &a, &x, &[0.4]).index_select(&order, 1).unwrap();
        assert!(worst(&found, &expected) < 1e-5);
    }
}

#[test]
fn every_parameter_receives_a_gradient() {
    reaches_every_parameter(&config(), &collate(&[&cars(3)]));
}

#[test]
fn rows_do_not_mix_samples_share_an_encoding_and_agents_have_no_order() {
    let scenes = Scenes { config: config(), cars, collate };
    scenes.do_not_mix();
    scenes.are_encoded_once();
    scenes.have_no_order();
}

#[test]
fn the_papers_network_has_15_layers_and_12_million_parameters() {
    let config = NetworkConfig::default();
    assert_eq!(config.layers.chars().filter(|c| !c.is_whitespace()).count(), 15);
    let mut params = Params::new(&Compute::cpu());
    SceneDenoiser::new(&mut params, &config, 3, Edm::default(), Seed(1)).unwrap();
    let linear = |n_in: usize, n_out: usize| n_in * n_out + n_out;
    let input = linear(3 * 256, 256) + linear(4 * 256 + 7, 256) + 2 * linear(256, 256);
    let lane_encoder = linear(35, 256) + 3 * linear(256, 256);
    let layer = 2 * 512 + linear(256, 3 * 256) + linear(256, 256) + linear(256, 1024) + linear(1024, 256);
    let output = 512 + linear(256, 256) + linear(256, 3);
    assert_eq!(params.n_parameters(), input + lane_encoder + 15 * layer + output);
    assert_eq!(params.n_parameters(), 12_712_707);
}

/// Fails unless two tensors agree to a ten-thousandth of the largest entry.
fn assert_close(name: &str, found: &Tensor, expected: &Tensor) {
    let scale = values(expected).iter().fold(0f64, |m, v| m.max(v.abs()));
    let error = worst(found, expected) / scale;
    assert!(error < 1e-4, "{name}: relative difference {error}");
}

/// Values and gradients of `scripts/torch_reference.py`, an implementation in PyTorch that shares no code with ours.
#[test]
fn outputs_and_gradients_are_those_of_pytorch() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/scene_network.safetensors");
    let golden = candle_core::safetensors::load(path, &Device::Cpu).unwrap();
    let config = NetworkConfig {
        layers: "TAMT".to_owned(),
        latent_periods: NetworkConfig::default().latent_periods,
        path_input: false,
        geometry: None,
        ..config()
    };
    let mut params = Params::new(&Compute::cpu());
    let network = SceneNetwork::new(&mut Scope::root(&mut params, Seed(1)), &config, 3).unwrap();
    let weights = golden.iter().filter_map(|(name, t)| Some((name.strip_prefix("weight.")?.to_owned(), t.clone())));
    params.load(&weights.collect()).unwrap();

    let input = |name: &str| &golden[&format!("input.{name}")];
    let known = network
        .encode_known(
            input("context"),
            input("features"),
            input("valid"),
            input("valid"),
            (input("lanes"), input("lane_valid")),
        )
        .unwrap();
    let x = candle_core::Var::from_tensor(input("x")).unwrap();
    let output = network.forward(x.as_tensor(), &known, input("c_noise")).unwrap();
    assert_close("output", &output, &golden["output"]);
    let gradients = (output * &golden["probe"]).unwrap().sum_all().unwrap().backward().unwrap();
    let valid = input("valid").unsqueeze(3).unwrap();
    let gradient_x = gradients.get(x.as_tensor()).unwrap().broadcast_mul(&valid).unwrap();
    assert_close("x", &gradient_x, &golden["gradient_x"]);
    for (name, var) in params.iter() {
        assert_close(name, gradients.get(var.as_tensor()).unwrap(), &golden[&format!("gradient.{name}")]);
    }
}

#[test]
fn the_carried_checkpoint_gives_what_it_gives_in_pytorch() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let checkpoint = root.join("pipelines/models/simulated_places.safetensors");
    let trained = TrainedDenoiser::read(&checkpoint, &Compute::cpu()).unwrap();
    let golden =
        candle_core::safetensors::load(root.join("tests/golden/carried_denoiser.safetensors"), &Device::Cpu).unwrap();
    let input = |name: &str| golden[&format!("input.{name}")].clone();
    let (entries, agents) = (input("latent").zeros_like().unwrap(), input("x").narrow(2, 0, 1).unwrap());
    let batch = SceneBatch::new(SceneTensors {
        x0: input("x").zeros_like().unwrap(),
        context: input("context"),
        features: input("features"),
        valid: input("valid"),
        latent: input("latent"),
        lanes: input("lanes"),
        lane_valid: input("lane_valid"),
        path: Some(input("path")),
        observed_motion: Some(input("observed_motion")),
        // The network does not read the rest.
        observed: entries.clone(),
        scored: entries,
        base: input("x").zeros_like().unwrap(),
        rotation: agents.squeeze(2).unwrap().narrow(2, 0, 2).unwrap().zeros_like().unwrap(),
        unit: agents.squeeze(2).unwrap().zeros_like().unwrap(),
        frames: vec![collate(&[&cars(2)]).frames[0].clone(); 4],
        surroundings: None,
    })
    .unwrap();
    let x = candle_core::Var::from_tensor(&input("x")).unwrap();
    let bound = trained.network.bind(&batch, 1).unwrap();
    let x0_hat = bound.denoise(x.as_tensor(), &input("sigma")).unwrap();
    assert_close("x0_hat", &x0_hat, &golden["output"]);
    let gradients = (x0_hat * &golden["probe"]).unwrap().sum_all().unwrap().backward().unwrap();
    assert_close("gradient", gradients.get(x.as_tensor()).unwrap(), &golden["gradient_x"]);
}

#[test]
fn residuals_that_motion_adds_up_to_are_seen_and_need_the_motion_parametrization() {
    let mut params = Params::new(&Compute::cpu());
    let denoiser = SceneDenoiser::new(&mut params, &config(), 3, Edm::default(), Seed(1)).unwrap();
    let batch = collate(&[&cars(2)]);
    let path = batch.unit_path().unwrap().unwrap();
    let norms = values(&path.sqr().unwrap().sum(3).unwrap());
    let latent = values(&batch.latent);
    assert!(norms.iter().zip(&latent).all(|(norm, latent)| (norm - latent).abs() < 1e-5));
    let x = noisy(&batch, 2);
    let sigma = Tensor::new(&[0.4f32], &Device::Cpu).unwrap();
    let run = |batch: &SceneBatch| denoiser.bind(batch, 1)?.denoise(&x, &sigma);
    let with_path =
        |path: Option<Tensor>| SceneBatch::new(SceneTensors { path, ..SceneTensors::clone(&batch) }).unwrap();
    let other = with_path(batch.path.as_ref().map(|path| path.zeros_like().unwrap()));
    assert!(worst(&run(&batch).unwrap(), &run(&other).unwrap()) > 1e-4);
    assert!(run(&with_path(None)).unwrap_err().to_string().contains("motion parametrization"));
}
