//! Padding never leaks between scenes and futures, hidden states are not seen, and the order of agents does not matter.

use super::tests::drives;
use super::*;
use crate::nn::testing::worst;
use crate::nn::{Compute, Params};
use crate::scene::Scene;
use crate::scene::testing::{Drive, scene};
use crate::seed::Seed;
use crate::tensor::testing::collator;
use crate::tensor::{FutureValidity, SceneBatch, StateParametrization};
use candle_core::{Device, Tensor};

fn config() -> SceneTransformerConfig {
    SceneTransformerConfig {
        encoder: "TAM".to_owned(),
        decoder: "AMT".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        // Encodings with short periods magnify rounding.
        encoding: 4,
        n_modes: 3,
    }
}

fn network() -> (Params, SceneTransformer) {
    let mut params = Params::new(&Compute::cpu());
    let network = SceneTransformer::new(&mut params, &config(), 3, StateParametrization::Motion, Seed(1)).unwrap();
    (params, network)
}

fn cars(n: usize, future_curvature_1pm: f64) -> Scene {
    let drives = drives(n);
    let turned: Vec<Drive> =
        drives.iter().map(|d| Drive { curvature_1pm: d.curvature_1pm + future_curvature_1pm, ..*d }).collect();
    let (mut recorded, other) = (scene(&drives), scene(&turned));
    for (track, other) in recorded.tracks.iter_mut().zip(&other.tracks) {
        let state = |t: usize| if t < 4 { track.trajectory.get(t) } else { other.trajectory.get(t) };
        track.trajectory = crate::scene::Trajectory::new((0..12).map(|t| state(t).copied()).collect());
    }
    recorded
}

fn collate(scenes: &[&Scene]) -> SceneBatch {
    collator([&cars(3, 0.0)], StateParametrization::Motion).predictive(scenes, FutureValidity::Recorded)
}

#[test]
fn a_scene_has_the_same_futures_alone_and_among_larger_ones() {
    let (_, network) = network();
    let (small, large) = (cars(2, 0.0), cars(5, 0.0));
    let alone = network.forward(&collate(&[&small])).unwrap();
    let together = network.forward(&collate(&[&large, &small])).unwrap();
    assert_eq!((together.x0.dims(), together.logits.dims()), ([6, 5, 12, 3].as_slice(), [2, 3].as_slice()));
    let own = together.x0.narrow(0, 3, 3).unwrap();
    assert!(worst(&own.narrow(1, 0, 2).unwrap(), &alone.x0) < 1e-4);
    assert!(worst(&together.logits.narrow(0, 1, 1).unwrap(), &alone.logits) < 1e-4);
    let padding = own.narrow(1, 2, 3).unwrap();
    assert_eq!(worst(&padding, &padding.zeros_like().unwrap()), 0.0);
    let history = own.narrow(2, 0, 4).unwrap();
    assert_eq!(worst(&history, &history.zeros_like().unwrap()), 0.0);
}

#[test]
fn futures_differ_and_do_not_depend_on_what_is_hidden() {
    let (_, network) = network();
    let (one, other) = (collate(&[&cars(3, 0.0)]), collate(&[&cars(3, 0.1)]));
    assert!(worst(&one.x0, &other.x0) > 0.1);
    let (a, b) = (network.forward(&one).unwrap(), network.forward(&other).unwrap());
    assert_eq!((worst(&a.x0, &b.x0), worst(&a.logits, &b.logits)), (0.0, 0.0));
    let mode = |i| a.x0.narrow(0, i, 1).unwrap();
    assert!(worst(&mode(0), &mode(1)) > 1e-2 && worst(&mode(1), &mode(2)) > 1e-2);
}

#[test]
fn the_order_of_agents_does_not_matter() {
    let (_, network) = network();
    let scene = cars(3, 0.0);
    let mut swapped = scene.clone();
    swapped.tracks.swap(1, 2);
    let (a, b) = (network.forward(&collate(&[&scene])).unwrap(), network.forward(&collate(&[&swapped])).unwrap());
    let order = Tensor::new(&[0u32, 2, 1], &Device::Cpu).unwrap();
    assert!(worst(&a.x0.index_select(&order, 1).unwrap(), &b.x0) < 1e-4);
    assert!(worst(&a.logits, &b.logits) < 1e-4);
}

#[test]
fn futures_are_ranked_by_probability() {
    let logits = Tensor::new(&[[0.0f32, 3f32.ln(), 0.0], [1000.0, 0.0, 1000.0]], &Device::Cpu).unwrap();
    let x0 = Tensor::zeros((6, 1, 1, 3), candle_core::DType::F32, &Device::Cpu).unwrap();
    let ranked = JointFutures { x0, logits }.ranked().unwrap();
    let expected = [[(1, 0.6), (0, 0.2), (2, 0.2)], [(0, 0.5), (2, 0.5), (1, 0.0)]];
    for (ranked, expected) in ranked.iter().zip(expected) {
        for ((mode, p), (expected_mode, expected_p)) in ranked.iter().zip(expected) {
            assert!(*mode == expected_mode && (p - expected_p).abs() < 1e-6, "{ranked:?}");
        }
    }
}

#[test]
fn the_published_network_has_12_layers_and_then_4() {
    let config = SceneTransformerConfig::default();
    let mut params = Params::new(&Compute::cpu());
    SceneTransformer::new(&mut params, &config, 3, StateParametrization::Scene, Seed(1)).unwrap();
    let count =
        |name: &str| params.iter().filter(|(n, _)| n.starts_with(name) && n.ends_with("norm_mix.weight")).count();
    assert_eq!((count("encoder."), count("decoder.")), (12, 4));
    let linear = |n_in: usize, n_out: usize| n_in * n_out + n_out;
    let input = linear(4 * 256 + 7, 256) + linear(256, 256) + linear(35, 256) + 3 * linear(256, 256);
    let layer = 2 * 512 + linear(256, 3 * 256) + linear(256, 256) + linear(256, 1024) + linear(1024, 256);
    let heads = 512 + linear(256, 256) + linear(256, 3) + linear(256, 256) + linear(256, 1);
    assert_eq!(params.n_parameters(), input + 16 * layer + 6 * 256 + heads);
}

#[test]
fn a_network_without_futures_or_with_unknown_layers_is_refused() {
    let error = |config| {
        SceneTransformer::new(&mut Params::new(&Compute::cpu()), &config, 3, StateParametrization::Motion, Seed(1))
            .unwrap_err()
            .to_string()
    };
    assert!(error(SceneTransformerConfig { n_modes: 0, ..config() }).contains("n_modes"));
    assert!(error(SceneTransformerConfig { decoder: "TX".to_owned(), ..config() }).contains('X'));
}
