//! The geometric network: gradients reach every parameter, padding and the order of agents do not matter, lanes and
//! neighbors do, and scenes that lack something work.

use super::tests::noisy;
use super::*;
use crate::diffusion::{Denoiser, Edm};
use crate::geometry::{Polyline, Vec2};
use crate::nn::testing::{assert_gradients, values, worst};
use crate::nn::{Compute, Params};
use crate::scene::testing::{Drive, scene};
use crate::scene::{AgentClass, Lane, LaneGraph, LaneId, Scene};
use crate::seed::Seed;
use crate::tensor::testing::collator;
use crate::tensor::{Collator, FutureValidity, MaskTask, SceneBatch, SceneTensors, Sight, StateParametrization};
use candle_core::{Device, Tensor};
use std::sync::Arc;

fn config() -> NetworkConfig {
    NetworkConfig {
        layers: "TMAT".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        geometry: Some(GeometryConfig { relation_width: 8, ..GeometryConfig::default() }),
        ..NetworkConfig::default()
    }
}

/// Two lanes side by side along x, one with a successor.
fn road(with_bounds: bool) -> Arc<LaneGraph> {
    let line = |x: f64, y: f64| Polyline((0..=6).map(|i| Vec2::new(x + f64::from(i) * 10.0, y)).collect());
    let lane = |id: i64, x: f64, y: f64| Lane {
        id: LaneId(id),
        centerline: line(x, y),
        left: if with_bounds { line(x, y + 1.75) } else { Polyline::default() },
        right: if with_bounds { line(x, y - 1.75) } else { Polyline::default() },
        successors: if id == 1 { vec![LaneId(3)] } else { Vec::new() },
        predecessors: Vec::new(),
        left_neighbor: (id == 1).then_some(LaneId(2)),
        right_neighbor: (id == 2).then_some(LaneId(1)),
        attributes: Arc::default(),
    };
    Arc::new(LaneGraph::new(vec![lane(1, -10.0, 0.0), lane(2, -10.0, 3.5), lane(3, 50.0, 0.0)]))
}

fn cars(n: usize, lanes: &Arc<LaneGraph>) -> Scene {
    let drive = |i: usize| Drive {
        x: 9.0 * i as f64,
        y: 3.5 * (i % 2) as f64,
        heading_rad: 0.05 * i as f64,
        speed_mps: 9.0 + i as f64,
        curvature_1pm: 0.01 * i as f64,
    };
    let scene = scene(&(0..n).map(drive).collect::<Vec<_>>());
    Scene { lanes: lanes.clone(), ..scene }
}

fn seeing_collator() -> Collator {
    let sight = Some(Sight::new(12));
    Collator { sight, ..collator([&cars(3, &road(true))], StateParametrization::Motion) }
}

fn collate(scenes: &[&Scene]) -> SceneBatch {
    seeing_collator().predictive(scenes, FutureValidity::Continued)
}

fn denoiser(params: &mut Params) -> SceneDenoiser {
    SceneDenoiser::new(params, &config(), 3, Edm::default(), Seed(1)).unwrap()
}

fn run(denoiser: &SceneDenoiser, batch: &SceneBatch, x: &Tensor, sigmas: &[f32]) -> Tensor {
    let sigma = Tensor::new(sigmas, &Device::Cpu).unwrap();
    denoiser.bind(batch, 1).unwrap().denoise(x, &sigma).unwrap()
}

#[test]
fn every_parameter_receives_a_gradient() {
    let whole = GeometryConfig { relation_width: 8, ..GeometryConfig::default() };
    let blind = GeometryConfig { own_pose: false, n_neighbors: 0, n_nearest_lanes: 0, ..whole.clone() };
    let without_lanes = GeometryConfig { n_nearest_lanes: 0, ..whole.clone() };
    for geometry in [whole, blind, without_lanes] {
        reaches_every_parameter(&NetworkConfig { geometry: Some(geometry), ..config() });
    }
}

fn reaches_every_parameter(config: &NetworkConfig) {
    let mut params = Params::new(&Compute::cpu());
    let denoiser = SceneDenoiser::new(&mut params, config, 3, Edm::default(), Seed(1)).unwrap();
    let batch = collate(&[&cars(3, &road(true))]);
    let x0_hat = run(&denoiser, &batch, &noisy(&batch, 2), &[0.4]);
    let loss = (x0_hat - &batch.x0).unwrap().sqr().unwrap().sum_all().unwrap();
    assert_gradients(&loss, &params, |_| true);
}

#[test]
fn a_row_is_the_same_alone_and_among_larger_scenes() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let (small, large) = (cars(2, &road(true)), cars(5, &road(true)));
    let (alone, together) = (collate(&[&small]), collate(&[&small, &large]));
    let x = noisy(&alone, 3);
    let both = Tensor::cat(&[&x.pad_with_zeros(1, 0, 3).unwrap(), &noisy(&collate(&[&large]), 4)], 0).unwrap();
    let expected = run(&denoiser, &alone, &x, &[0.7]);
    let found = run(&denoiser, &together, &both, &[0.7, 2.0]).get(0).unwrap();
    assert!(worst(&found.narrow(0, 0, 2).unwrap(), &expected.get(0).unwrap()) < 1e-5);
    assert!(values(&found.narrow(0, 2, 3).unwrap()).iter().all(|x| *x == 0.0));
}

#[test]
fn samples_of_one_scene_share_its_encoding() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let batch = collate(&[&cars(3, &road(true)), &cars(2, &road(true))]);
    let repeated = batch.repeated(2).unwrap();
    let x = noisy(&repeated, 5);
    let sigma = Tensor::new(&[0.5f32, 0.5, 0.9, 0.9], &Device::Cpu).unwrap();
    let shared = denoiser.bind(&batch, 2).unwrap().denoise(&x, &sigma).unwrap();
    let apart = denoiser.bind(&repeated, 1).unwrap().denoise(&x, &sigma).unwrap();
    assert!(worst(&shared, &apart) < 1e-5);
}

#[test]
fn the_order_of_agents_does_not_matter() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let scene = cars(3, &road(true));
    let mut swapped = scene.clone();
    swapped.tracks.swap(1, 2);
    let (a, b) = (collate(&[&scene]), collate(&[&swapped]));
    let x = noisy(&a, 6);
    let order = Tensor::new(&[0u32, 2, 1], &Device::Cpu).unwrap();
    let found = run(&denoiser, &b, &x.index_select(&order, 1).unwrap(), &[0.4]);
    let expected = run(&denoiser, &a, &x, &[0.4]).index_select(&order, 1).unwrap();
    assert!(worst(&found, &expected) < 1e-5);
}

#[test]
fn the_whole_scene_may_be_turned_and_moved() {
    // Coordinates are relative to the ego agent: the origin of a recording makes no difference.
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let scene = cars(3, &road(true));
    let moved = crate::geometry::Transform2::from_pose(Vec2::new(400.0, -250.0), 2.0);
    let mut other = Scene { lanes: Arc::new(scene.lanes.transformed(&moved)), ..scene.clone() };
    for track in &mut other.tracks {
        let states = track.trajectory.entries().iter().map(|state| state.map(|s| s.transformed(&moved)));
        track.trajectory = crate::scene::Trajectory::new(states.collect());
    }
    let (a, b) = (collate(&[&scene]), collate(&[&other]));
    let x = noisy(&a, 6);
    assert!(worst(&run(&denoiser, &a, &x, &[0.4]), &run(&denoiser, &b, &x, &[0.4])) < 2e-3);
}

#[test]
fn lanes_and_neighbors_make_a_difference_at_every_noise_level() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let scene = cars(2, &road(true));
    let shifted = road(true).transformed(&crate::geometry::Transform2::from_pose(Vec2::new(0.0, 1.0), 0.0));
    let elsewhere = Scene { lanes: Arc::new(shifted), ..scene.clone() };
    let mut closer = scene.clone();
    closer.tracks[1].extent = Some(crate::scene::Extent { length_m: 9.0, width_m: 2.0 });
    let batch = collate(&[&scene]);
    let x = noisy(&batch, 7);
    for sigma in [0.05, 0.8, 10.0] {
        let expected = run(&denoiser, &batch, &x, &[sigma]);
        assert!(worst(&run(&denoiser, &collate(&[&elsewhere]), &x, &[sigma]), &expected) > 1e-5, "σ = {sigma}");
        let seen = run(&denoiser, &collate(&[&closer]), &x, &[sigma]).get(0).unwrap().get(0).unwrap();
        assert!(worst(&seen, &expected.get(0).unwrap().get(0).unwrap()) > 1e-6, "σ = {sigma}");
    }
}

#[test]
fn what_is_missing_is_masked() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let mut unsized_agents = cars(2, &road(true));
    unsized_agents.tracks.iter_mut().for_each(|track| track.extent = None);
    let mut walker = cars(2, &road(true));
    walker.tracks[1].class = AgentClass::PedestrianOrCyclist;
    let none = Arc::new(LaneGraph::default());
    for scene in [cars(2, &none), cars(2, &road(false)), cars(1, &road(true)), cars(1, &none), unsized_agents, walker] {
        let batch = collate(&[&scene]);
        let x = noisy(&batch, 8);
        let x0_hat = values(&run(&denoiser, &batch, &x, &[0.5]));
        assert!(x0_hat.iter().all(|x| x.is_finite()) && x0_hat.iter().any(|x| *x != 0.0));
    }
}

#[test]
fn headings_that_are_not_recorded_are_not_generated() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let mut scene = cars(2, &road(true));
    scene.tracks[1].class = AgentClass::PedestrianOrCyclist;
    let batch = collate(&[&scene]);
    let x0_hat = run(&denoiser, &batch, &noisy(&batch, 8), &[0.5]);
    let headings = |agent: usize| values(&x0_hat.narrow(1, agent, 1).unwrap().narrow(3, 2, 1).unwrap());
    assert!(headings(0).iter().any(|h| *h != 0.0) && headings(1).iter().all(|h| *h == 0.0));
    // They follow from the motion.
    let decoded = &batch.decode_scenes(&batch.x0, &[&scene]).unwrap()[0];
    let state = decoded.state(1, 9).unwrap();
    assert!(crate::geometry::angle_difference(state.heading_rad, state.velocity.angle()).abs() < 1e-6);
}

#[test]
fn training_tells_the_network_what_sampling_tells_it() {
    // The second agent leaves after timestep 7.
    let scene = crate::scene::testing::without_states(cars(2, &road(true)), 1, |t| t > 7);
    for task in [MaskTask::Predictive, MaskTask::GoalConditioned, MaskTask::Windowed, MaskTask::Imputation] {
        let mask = task.sample(&scene, 0, &mut Seed(4).rng());
        let trained = seeing_collator().masked(&scene, &mask, FutureValidity::Continued);
        let sampled = seeing_collator().masked(&scene, &mask, FutureValidity::Everything);
        assert_eq!(values(&trained.latent), values(&sampled.latent), "{task:?}");
        assert_eq!(values(&trained.base), values(&sampled.base), "{task:?}");
        let scored = seeing_collator().masked(&scene, &mask, FutureValidity::Recorded);
        assert_eq!(values(&trained.scored), values(&scored.latent), "{task:?}");
    }
}

#[test]
fn batches_without_surroundings_are_refused() {
    let denoiser = denoiser(&mut Params::new(&Compute::cpu()));
    let tensors = SceneTensors { surroundings: None, ..SceneTensors::clone(&collate(&[&cars(2, &road(true))])) };
    let batch = SceneBatch::new(tensors).unwrap();
    assert!(denoiser.bind(&batch, 1).unwrap_err().to_string().contains("surrounds"));
}
