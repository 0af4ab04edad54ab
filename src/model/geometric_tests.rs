//! The geometric network: gradients reach every parameter, padding and the order of agents do not matter, lanes and
//! neighbors do, and scenes that lack something work.

use super::tests::{Scenes, noisy, reaches_every_parameter, run};
use super::*;
use crate::diffusion::Edm;
use crate::geometry::{Polyline, Vec2};
use crate::nn::testing::{values, worst};
use crate::nn::{Compute, Params};
use crate::scene::testing::{Drive, scene};
use crate::scene::{AgentClass, Lane, LaneGraph, LaneId, Scene};
use crate::seed::Seed;
use crate::tensor::testing::collator;
use crate::tensor::{Collator, FutureValidity, MaskTask, SceneBatch, SceneTensors, Sight, StateParametrization};
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

#[test]
fn every_parameter_receives_a_gradient() {
    let whole = GeometryConfig { relation_width: 8, ..GeometryConfig::default() };
    let blind = GeometryConfig { own_pose: false, n_neighbors: 0, n_nearest_lanes: 0, ..whole.clone() };
    let without_lanes = GeometryConfig { n_nearest_lanes: 0, ..whole.clone() };
    for geometry in [whole, blind, without_lanes] {
        let batch = collate(&[&cars(3, &road(true))]);
        reaches_every_parameter(&NetworkConfig { geometry: Some(geometry), ..config() }, &batch);
    }
}

#[test]
fn rows_do_not_mix_samples_share_an_encoding_and_agents_have_no_order() {
    let scenes = Scenes { config: config(), cars: |n| cars(n, &road(true)), collate };
    scenes.do_not_mix();
    scenes.are_encoded_once();
    scenes.have_no_order();
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
