//! Does the denoiser see the requested event, with values that belong to it, and are these samples like others
//! reproducible?

use super::testing::{config, difference_m, drift, index, load};
use super::*;
use crate::guidance::testing::denoiser_spec;
use crate::metrics::MetricSettings;
use crate::model::{GeometryConfig, ModelSpec, NetworkConfig, TrainedDenoiser};
use crate::nn::{Compute, Params};
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::seed::Seed;
use crate::tensor::{EventExample, EventVocabulary, KnownBehavior, StateParametrization};
use candle_core::Device;
use serde_json::Value;
use std::collections::BTreeMap;

const TOLD: &str = "behavior = 'drift'\nvalidity_strength = 0.0\nclassifier_free = { event = true, weights =";

fn sweep(more: &str) -> GenerateConfig {
    config(&format!("splits = ['train']\n[[sweeps]]\nname = 'a'\nn_scenes = 3\nn_samples = 4\n{more}"))
}

/// Events with gaps of 1 to 24 m, whose agents drove at 1 to 24 m/s.
fn vocabulary(id: &str) -> EventVocabulary {
    let values = |i: u32| BTreeMap::from([("gap_m".to_owned(), f64::from(i)), ("onset_s".to_owned(), 0.5)]);
    let example = |i: u32| EventExample { present: vec![f64::from(i), f64::from(i), 0.0, 0.0], values: values(i) };
    let events: Vec<_> = (1..25).map(values).collect();
    let known = KnownBehavior::new(id, &["ego", "other"], &events, (1..25).map(example).collect());
    EventVocabulary { behaviors: vec![known] }
}

/// A geometric denoiser with random weights that has inputs for these events, and on whose answers they have an effect.
fn denoiser(events: Option<EventVocabulary>) -> TrainedDenoiser {
    let mut spec = denoiser_spec(StateParametrization::Motion);
    spec.network = NetworkConfig {
        layers: "TA".to_owned(),
        geometry: Some(GeometryConfig { relation_width: 8, ..GeometryConfig::default() }),
        ..spec.network
    };
    spec.events = events;
    let mut params = Params::new(&Compute::cpu()).frozen();
    let network = spec.build(&mut params, Seed(1)).unwrap();
    let mut tensors = params.tensors();
    if let Some(weight) = tensors.get_mut("input.event.weight") {
        *weight = ((weight.ones_like().unwrap()) * 0.5).unwrap();
    }
    params.load(&tensors).unwrap();
    TrainedDenoiser { network, spec, fingerprint: "denoiser".to_owned() }
}

fn with<T>(
    denoiser: &TrainedDenoiser,
    config: &GenerateConfig,
    use_it: impl FnOnce(&Generator<'_>) -> T,
) -> Result<T, Error> {
    let models = Models { denoiser, classifiers: &[], distilled: None, baseline: None };
    let (behaviors, config) = (drift(), config.resolve(&drift())?);
    let generator = Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu)?;
    Ok(use_it(&generator))
}

fn generated(config: &GenerateConfig) -> Vec<ScenarioRecord> {
    let generate = |generator: &Generator<'_>| {
        let plan = generator.plan(&index(12)).unwrap();
        plan.shards.iter().flat_map(|shard| generator.generate(shard, &Silent).unwrap().records).collect()
    };
    with(&denoiser(Some(vocabulary("drift"))), config, generate).unwrap()
}

fn at(records: &[ScenarioRecord], weight: f64) -> Vec<ScenarioRecord> {
    records.iter().filter(|r| r.scenario.provenance.guidance.level.weight == weight).cloned().collect()
}

fn told(record: &ScenarioRecord) -> Value {
    serde_json::from_str::<Value>(&record.scenario.provenance.settings).unwrap()["told"].clone()
}

#[test]
fn told_samples_differ_and_weight_zero_is_unguided() {
    let records = generated(&sweep(&format!("{TOLD} [0.0, 1.0, 2.0] }}")));
    let (unguided, plain, more) = (at(&records, 0.0), at(&records, 1.0), at(&records, 2.0));
    assert_eq!((unguided.len(), plain.len(), more.len()), (12, 12, 12));
    assert_eq!(unguided, generated(&sweep("behavior = 'drift'\nvalidity_strength = 0.0")));
    for ((a, b), c) in unguided.iter().zip(&plain).zip(&more) {
        let apart = |other: &ScenarioRecord| difference_m(&a.scenario.scene, &other.scenario.scene);
        assert!(apart(b) > 1e-3 && apart(c) > apart(b), "{} and {} m", apart(b), apart(c));
        assert_eq!(told(a), Value::Null);
        assert_eq!(b.scenario.provenance.guidance.kind, "event");
        assert_eq!(told(b), told(c), "all weights of a sample are told the same");
        assert!(told(b)["gap_m"].as_f64().is_some_and(|gap_m| (1.0..25.0).contains(&gap_m)), "{}", told(b));
    }
    let distinct: std::collections::BTreeSet<String> = plain.iter().map(|record| told(record).to_string()).collect();
    assert!(distinct.len() > 3, "{distinct:?}");
}

#[test]
fn they_are_generated_again_to_the_bit_and_do_not_depend_on_batches() {
    let config = sweep(&format!("{TOLD} [1.0, 2.0] }}"));
    let expected = generated(&config);
    let again = |generator: &Generator<'_>| {
        let plan = generator.plan(&index(12)).unwrap();
        let shard = &plan.shards[0];
        let key = |record: &ScenarioRecord| SampleKey::of(shard, &record.scenario.provenance).unwrap();
        expected.iter().map(|record| generator.regenerate(shard, key(record)).unwrap().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(with(&denoiser(Some(vocabulary("drift"))), &config, again).unwrap(), expected);
    let alone = generated(&GenerateConfig { batch_size: 1, ..config });
    for (a, b) in expected.iter().zip(&alone) {
        assert_eq!((&a.scenario.id, told(a)), (&b.scenario.id, told(b)));
        assert!(difference_m(&a.scenario.scene, &b.scenario.scene) < 1e-2);
    }
}

#[test]
fn values_are_those_of_events_that_began_alike() {
    // Cars of the scenes drive at 6 to 10 m/s: the 16 examples nearest to them are of 1 to 18 m/s at most.
    let records = generated(&sweep(&format!("{TOLD} [1.0] }}")));
    assert!(records.iter().all(|record| told(record)["gap_m"].as_f64().unwrap() <= 18.0));
}

#[test]
fn samples_that_aim_are_told_what_they_aim_at() {
    let aimed = |vocabulary: EventVocabulary, gaps_m: [f64; 2]| -> Vec<Value> {
        let generate = |generator: &Generator<'_>| {
            let mut shard = generator.plan(&index(12)).unwrap().shards.remove(0);
            let target = BTreeMap::from([("gap_m".to_owned(), gaps_m), ("place".to_owned(), [0.0, 1.0])]);
            shard.cells.iter_mut().for_each(|cell| cell.targets = vec![target.clone()]);
            generator.generate(&shard, &Silent).unwrap().records.iter().map(told).collect()
        };
        with(&denoiser(Some(vocabulary)), &sweep(&format!("{TOLD} [1.0] }}")), generate).unwrap()
    };
    // The events with 20 or 21 m, among gaps of 1 to 24 m, although others began more alike.
    let told = aimed(vocabulary("drift"), [19.5, 21.5]);
    let gaps_m: Vec<f64> = told.iter().map(|told| told["gap_m"].as_f64().unwrap()).collect();
    assert!(gaps_m.contains(&20.0) && gaps_m.contains(&21.0), "{gaps_m:?}");
    assert!(gaps_m.iter().all(|gap_m| [20.0, 21.0].contains(gap_m)), "{gaps_m:?}");
    assert!(told.iter().all(|told| told["onset_s"] == 0.5), "values of an event belong together");
    // Where no event lies in the target, the denoiser sees the target alone.
    for told in aimed(vocabulary("drift"), [30.0, 31.0]) {
        let gap_m = told["gap_m"].as_f64().unwrap();
        assert!(told.as_object().unwrap().len() == 1 && (30.0..31.0).contains(&gap_m), "{told}");
    }
}

#[test]
fn denoisers_that_do_not_know_the_behavior_refuse() {
    let config = sweep(&format!("{TOLD} [1.0] }}"));
    let refusal = |denoiser: &TrainedDenoiser| with(denoiser, &config, |_| ()).unwrap_err().to_string();
    let unknown = refusal(&denoiser(Some(vocabulary("cut_in"))));
    assert!(unknown.contains("sweep a: the denoiser cannot be told of drift") && unknown.contains("trained on cut_in"));
    let without = refusal(&denoiser(None));
    assert!(without.contains("was not trained on events") && without.contains("[train.denoiser.events]"), "{without}");
}

#[test]
fn telling_costs_a_second_evaluation_only_where_estimates_are_mixed() {
    let cost = |weights: &str| {
        let resolved = sweep(&format!("{TOLD} {weights} }}")).resolve(&drift()).unwrap();
        resolved.sweeps[0].n_evaluations()
    };
    assert_eq!(cost("[2.0]"), 2 * cost("[0.0, 1.0]"));
}
