//! Sweeps of the baseline: which futures become samples, with which provenance, and what is rejected.

use super::testing::{config, denoiser, difference_m, drift, index, load};
use super::*;
use crate::guidance::testing::scene;
use crate::metrics::MetricSettings;
use crate::model::{SceneTransformer, SceneTransformerConfig, SceneTransformerKind, SceneTransformerSpec};
use crate::model::{TrainedDenoiser, TrainedSceneTransformer};
use crate::nn::{Compute, Params};
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::scene::{ObservationMask, Scene};
use crate::seed::Seed;
use crate::store::as_stored;
use crate::tensor::StateParametrization;
use crate::tensor::{FutureValidity, SceneView};
use candle_core::Device;

fn baseline() -> TrainedSceneTransformer {
    let TrainedDenoiser { spec, .. } = denoiser(0);
    let network = SceneTransformerConfig {
        encoder: "TAM".to_owned(),
        decoder: "TA".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        encoding: 4,
        n_modes: 4,
    };
    let spec = SceneTransformerSpec {
        kind: SceneTransformerKind::SceneTransformer,
        network,
        normalizer: spec.normalizer,
        n_history: spec.n_history,
        n_timesteps: spec.n_timesteps,
        dt_s: spec.dt_s,
        max_agents: spec.max_agents,
        max_lanes: spec.max_lanes,
        steps: 0,
        seed: 0,
        scenes: String::new(),
    };
    let network = SceneTransformer::new(
        &mut Params::new(&Compute::cpu()).frozen(),
        &spec.network,
        3,
        StateParametrization::Motion,
        Seed(5),
    )
    .unwrap();
    TrainedSceneTransformer { network, spec, fingerprint: "baseline".to_owned() }
}

fn generate(toml: &str, baseline: Option<&TrainedSceneTransformer>) -> Result<Vec<ScenarioRecord>, Error> {
    let behaviors = drift();
    let (denoiser, config) = (denoiser(0), config(toml).resolve(&behaviors)?);
    let models = Models { denoiser: &denoiser, classifiers: &[], distilled: None, baseline };
    let generator = Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu)?;
    let plan = generator.plan(&index(4))?;
    let mut records = Vec::new();
    for shard in &plan.shards {
        records.extend(generator.generate(shard, &Silent)?.records);
    }
    Ok(records)
}

fn sweep(rest: &str) -> String {
    format!("splits = ['train']\n[[sweeps]]\nname = 'a'\nmodel = 'baseline'\nn_scenes = 2\n{rest}\n")
}

#[test]
fn the_likeliest_futures_come_first_and_say_what_made_them() {
    let baseline = baseline();
    let records = generate(&sweep("n_samples = 3"), Some(&baseline)).unwrap();
    assert_eq!(records.len(), 6);
    for samples in records.chunks(3) {
        let scene_id = &samples[0].scenario.provenance.scene_id;
        let source = (0..4).map(scene).find(|scene| scene.id == *scene_id).unwrap();
        let futures = futures_of(&baseline, &source);
        for (sample_idx, (record, (expected, p))) in samples.iter().zip(&futures).enumerate() {
            let provenance = &record.scenario.provenance;
            assert_eq!((provenance.sample_idx, provenance.checkpoint.as_str()), (sample_idx, "baseline"));
            let found = (provenance.guidance.kind.as_str(), provenance.sampler.as_str());
            assert_eq!(found, ("scene_transformer", "forward-1"));
            assert!((provenance.probability.unwrap() - p).abs() < 1e-5);
            assert!(difference_m(&record.scenario.scene, &as_stored(expected)) < 1e-2);
        }
        assert!(futures.windows(2).all(|pair| pair[0].1 >= pair[1].1));
        assert!(difference_m(&samples[0].scenario.scene, &samples[1].scenario.scene) > 1e-3);
    }
}

/// All futures of a scene alone, sorted by the softmax of their logits, one decoded at a time.
fn futures_of(baseline: &TrainedSceneTransformer, source: &Scene) -> Vec<(Scene, f64)> {
    let mask = ObservationMask::predictive(source.tracks.len(), source.n_timesteps, source.n_history);
    let view = SceneView { scene: source, ego_idx: source.ego_idx, mask: &mask };
    let batch = baseline.spec.collator().collate(&[view], FutureValidity::Everything, &Device::Cpu).unwrap();
    let futures = baseline.network.forward(&batch).unwrap();
    let weights: Vec<f64> =
        futures.logits.to_vec2::<f32>().unwrap()[0].iter().map(|logit| f64::from(*logit).exp()).collect();
    let decode =
        |mode: usize| batch.decode_scenes(&futures.x0.narrow(0, mode, 1).unwrap(), &[source]).unwrap().remove(0);
    let sum: f64 = weights.iter().sum();
    let mut all: Vec<_> = weights.iter().enumerate().map(|(mode, weight)| (decode(mode), weight / sum)).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    all
}

#[test]
fn samples_do_not_depend_on_batches() {
    let baseline = baseline();
    let together = generate(&sweep("n_samples = 4"), Some(&baseline)).unwrap();
    let apart = generate(&format!("batch_size = 3\n{}", sweep("n_samples = 4")), Some(&baseline)).unwrap();
    assert_eq!(together.len(), apart.len());
    for (a, b) in together.iter().zip(&apart) {
        assert_eq!(a.scenario.id, b.scenario.id);
        assert!(difference_m(&a.scenario.scene, &b.scenario.scene) < 1e-2);
    }
}

#[test]
fn a_baseline_that_does_not_fit_is_refused() {
    let own = baseline();
    let refusal = |rest: &str, baseline| generate(&sweep(rest), baseline).unwrap_err().to_string();
    assert!(refusal("n_samples = 5", Some(&own)).contains("has 4 joint futures"));
    let message = refusal("n_samples = 4", None);
    assert!(message.contains("[train.baseline]"), "{message}");
    let mut other = self::baseline();
    other.spec.n_timesteps += 1;
    let message = refusal("n_samples = 4", Some(&other));
    assert!(message.contains("different timesteps"), "{message}");
}
