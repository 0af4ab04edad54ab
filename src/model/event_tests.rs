//! Events as inputs of the geometric network: nothing changes before training, every given input learns, and only
//! agents that take part have inputs.

use super::event_input::EventInput;
use super::tests::noisy;
use super::*;
use crate::diffusion::{Denoiser, Edm};
use crate::nn::testing::{values, worst};
use crate::nn::{Compute, Params};
use crate::scene::testing::{Drive, scene};
use crate::seed::Seed;
use crate::tensor::testing::collator;
use crate::tensor::{
    Collator, EventVocabulary, FutureValidity, KnownBehavior, SceneBatch, Sight, StateParametrization, ToldEvent,
};
use candle_core::{Device, Tensor};
use std::collections::BTreeMap;

fn config() -> NetworkConfig {
    NetworkConfig {
        layers: "TA".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        geometry: Some(GeometryConfig { relation_width: 8, ..GeometryConfig::default() }),
        ..NetworkConfig::default()
    }
}

fn vocabulary() -> EventVocabulary {
    let event = |gap_m: f64, side: f64| BTreeMap::from([("gap_m".to_owned(), gap_m), ("side".to_owned(), side)]);
    let events = [event(3.0, 1.0), event(9.0, -1.0), event(5.0, 1.0)];
    EventVocabulary { behaviors: vec![KnownBehavior::new("cut_in", &["ego", "other"], &events, vec![])] }
}

fn batch() -> SceneBatch {
    let scene = scene(&[0.0, 12.0, 30.0].map(|x| Drive::straight(x, 0.0, 0.1, 9.0)));
    let collator = Collator { sight: Some(Sight::new(12)), ..collator([&scene], StateParametrization::Motion) };
    collator.predictive(&[&scene], FutureValidity::Continued)
}

fn told(batch: &SceneBatch, side: f64) -> SceneBatch {
    let values = BTreeMap::from([("gap_m".to_owned(), 9.0), ("side".to_owned(), side)]);
    let event = ToldEvent { behavior: "cut_in".to_owned(), agents: vec![2, 0], values };
    batch.telling(&vocabulary(), &[Some(event)]).unwrap()
}

fn denoiser(params: &mut Params) -> SceneDenoiser {
    let sizes = (3, vocabulary().n_inputs());
    SceneDenoiser::with_events(params, &config(), sizes, Edm::default(), Seed(1)).unwrap()
}

fn run(denoiser: &SceneDenoiser, batch: &SceneBatch, n_samples: usize) -> Tensor {
    let x = noisy(&batch.repeated(n_samples).unwrap(), 3);
    let sigma = Tensor::new(vec![0.7f32; n_samples], &Device::Cpu).unwrap();
    denoiser.bind(batch, n_samples).unwrap().denoise(&x, &sigma).unwrap()
}

/// A step along the gradient for the projection of events, as large as its weights are in a trained network.
fn stepped(params: &Params, loss: &Tensor) -> Tensor {
    let gradients = loss.backward().unwrap();
    let (_, weight) = params.iter().find(|(name, _)| *name == EventInput::TENSOR).unwrap();
    let gradient = gradients.get(weight.as_tensor()).unwrap().clone();
    let largest = values(&gradient).into_iter().fold(0.0, |largest: f64, g| largest.max(g.abs()));
    weight.set(&(weight.as_detached_tensor() - (&gradient * (0.5 / largest)).unwrap()).unwrap()).unwrap();
    gradient
}

fn loss(batch: &SceneBatch, x0_hat: &Tensor) -> Tensor {
    (x0_hat - &batch.x0).unwrap().sqr().unwrap().sum_all().unwrap()
}

#[test]
fn before_training_nothing_changes_and_after_a_step_every_told_input_counts() {
    let mut params = Params::new(&Compute::cpu());
    let denoiser = denoiser(&mut params);
    let plain = SceneDenoiser::new(&mut Params::new(&Compute::cpu()), &config(), 3, Edm::default(), Seed(1)).unwrap();
    let (untold, told) = (batch(), told(&batch(), -1.0));
    let expected = values(&run(&plain, &untold, 1));
    assert_eq!(values(&run(&denoiser, &untold, 1)), expected);
    let answer = run(&denoiser, &told, 1);
    assert_eq!(values(&answer), expected, "a projection of 0 adds nothing");

    let gradient = stepped(&params, &loss(&told, &answer)).t().unwrap();
    // For each of the two roles: who takes part, then each of two values with its flag.
    assert_eq!(gradient.dims(), [10, 16]);
    for input in 0..10 {
        let row = values(&gradient.get(input).unwrap());
        assert!(row.iter().any(|g| *g != 0.0), "input {input}");
    }
    assert_eq!(values(&run(&denoiser, &untold, 1)), expected, "who is told nothing is as before");
    assert!(worst(&run(&denoiser, &told, 1), &answer) > 1e-4);
}

#[test]
fn the_sign_of_a_side_makes_a_difference() {
    let mut params = Params::new(&Compute::cpu());
    let denoiser = denoiser(&mut params);
    let (left, right) = (told(&batch(), 1.0), told(&batch(), -1.0));
    stepped(&params, &loss(&left, &run(&denoiser, &left, 1)));
    assert!(worst(&run(&denoiser, &left, 1), &run(&denoiser, &right, 1)) > 1e-4);
}

#[test]
fn samples_of_a_row_share_what_it_is_told() {
    let mut params = Params::new(&Compute::cpu());
    let denoiser = denoiser(&mut params);
    let told = told(&batch(), 1.0);
    stepped(&params, &loss(&told, &run(&denoiser, &told, 1)));
    assert!(worst(&run(&denoiser, &told, 2), &run(&denoiser, &told.repeated(2).unwrap(), 1)) < 1e-5);
}

#[test]
fn networks_that_cannot_be_told_refuse() {
    let plain = SceneDenoiser::new(&mut Params::new(&Compute::cpu()), &config(), 3, Edm::default(), Seed(1)).unwrap();
    let error = plain.bind(&told(&batch(), 1.0), 1).unwrap_err().to_string();
    assert!(error.contains("cannot be told of events"), "{error}");
    let papers = NetworkConfig { encoding: 8, geometry: None, ..config() };
    let params = &mut Params::new(&Compute::cpu());
    let error = SceneDenoiser::with_events(params, &papers, (3, 10), Edm::default(), Seed(1)).unwrap_err();
    assert!(error.to_string().contains("only the geometric network"), "{error}");
}
