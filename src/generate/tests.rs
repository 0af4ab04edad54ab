//! Is the result independent of how it is generated, paired across strengths, and guarded against nonsense?

mod combined;
mod guidance;

use super::testing::*;
use super::*;
use crate::behavior::Behavior;
use crate::guidance::testing::{N_HISTORY, scene};
use crate::metrics::MetricSettings;
use crate::model::{DenoiserSpec, Distillation, TrainedClassifier};
use crate::progress::Silent;
use crate::scene::Scene;
use crate::store::{SceneIndex, as_stored};
use crate::tensor::Collator;
use candle_core::Device;
use std::sync::Arc;

const SWEEPS: &str = "
    splits = ['train']
    [[sweeps]]
    name = 'plain'
    n_scenes = 5
    n_samples = 3
    [[sweeps]]
    name = 'guided'
    n_scenes = 4
    n_samples = 2
    behavior = 'drift'
    strengths = [0.0, 3.0]
";

#[test]
fn batches_and_shards_do_not_matter() {
    let reference = generate(&config(SWEEPS));
    assert_eq!(reference.len(), 5 * 3 + 4 * 2 * 2);
    for (batch_size, scenes_per_shard) in [(1, 8), (2, 1), (7, 2), (100, 3)] {
        let other = generate(&GenerateConfig { batch_size, scenes_per_shard, ..config(SWEEPS) });
        for (a, b) in reference.iter().zip(&other) {
            assert_eq!((&a.scenario.id, &a.scenario.provenance), (&b.scenario.id, &b.scenario.provenance));
            let difference_m = difference_m(&a.scenario.scene, &b.scenario.scene);
            assert!(difference_m < ROUNDING_M, "batches of {batch_size}: {difference_m} m apart");
        }
    }
}

#[test]
fn the_same_call_gives_the_same_bytes() {
    assert_eq!(generate(&config(SWEEPS)), generate(&config(SWEEPS)));
    let other_seed = generate(&GenerateConfig { seed: 1, ..config(SWEEPS) });
    assert_ne!(generate(&config(SWEEPS))[0].scenario.id, other_seed[0].scenario.id);
}

#[test]
fn histories_are_kept_and_samples_differ() {
    for record in generate(&config(SWEEPS)) {
        let Scene { tracks, .. } = &record.scenario.scene;
        let idx: usize = record.scenario.scene.source.case_id.parse().unwrap();
        for (track, recorded) in tracks.iter().zip(&as_stored(&scene(idx)).tracks) {
            assert_eq!(track.trajectory.entries()[..N_HISTORY], recorded.trajectory.entries()[..N_HISTORY]);
            assert_ne!(track.trajectory.entries()[N_HISTORY..], recorded.trajectory.entries()[N_HISTORY..]);
        }
    }
    let records = generate(&config(SWEEPS));
    assert!(difference_m(&records[0].scenario.scene, &records[1].scenario.scene) > 5.0 * ROUNDING_M);
    let ids: std::collections::BTreeSet<&String> = records.iter().map(|record| &record.scenario.id).collect();
    assert_eq!(ids.len(), records.len());
}

#[test]
fn strengths_are_paired_and_zero_is_unguided() {
    let records = generate(&config(SWEEPS));
    let unguided = generate(&config(&SWEEPS.replace("[0.0, 3.0]", "[0.0]")));
    for (guided, unguided) in records[15..].chunks(4).zip(unguided[15..].chunks(2)) {
        let of =
            |strength: f64| guided.iter().filter(move |r| r.scenario.provenance.guidance.level.strength == strength);
        for (a, b) in of(0.0).zip(unguided) {
            assert_eq!(a, b);
            let found = (a.scenario.provenance.guidance.kind.as_str(), &a.scenario.provenance.classifier);
            assert_eq!(found, ("none", &None));
        }
        for (a, b) in of(0.0).zip(of(3.0)) {
            let (plain, tag) = (&a.scenario.provenance, &b.scenario.provenance);
            assert_eq!((plain.sample_idx, &plain.guidance.roles), (tag.sample_idx, &tag.guidance.roles));
            let seen = (tag.guidance.kind.as_str(), tag.classifier.as_deref());
            assert_eq!(seen, ("classifier:drift", Some("classifier")));
            let difference_m = difference_m(&a.scenario.scene, &b.scenario.scene);
            assert!(difference_m > 1e-3, "guidance changed nothing");
        }
    }
}

#[test]
fn verdicts_are_the_miners() {
    let records = generate(&config(SWEEPS));
    assert!(records[..15].iter().all(|record| !record.verified && record.events.is_empty()));
    for record in &records[15..] {
        let roles = &record.scenario.provenance.guidance.roles;
        let found = Drift.detect(&record.scenario.scene);
        assert_eq!(record.events.len(), found.len());
        assert_eq!(record.verified, found.iter().any(|event| event.roles == *roles));
        assert!(!record.verified || record.events[0].roles == *roles);
        assert!(!record.recorded_event, "pairs that do it anyway are not asked");
    }
}

#[test]
fn the_plan_does_not_depend_on_the_order_of_scenes() {
    let config = config(SWEEPS);
    with_generator(&config, 0, |generator| {
        let plan = generator.plan(&index(12)).unwrap();
        assert_eq!(plan, generator.plan(&index(12)).unwrap());
        assert_eq!(plan.n_samples(generator.config), 31);
        assert!(plan.shortfalls.is_empty());
        let ids = |plan: &Plan| -> Vec<_> {
            plan.shards.iter().flat_map(|s| s.cells.iter().map(|c| (c.scene_id.clone(), c.roles.clone()))).collect()
        };
        let reversed: SceneIndex = index(12).iter().rev().collect();
        let moved = |idx: usize| load(11 - idx);
        let metric_settings = generator.metric_settings.clone();
        let collator = generator.collator.clone();
        let reversed_generator = Generator { scenes: &moved, metric_settings, collator, ..*generator };
        assert_eq!(ids(&plan), ids(&reversed_generator.plan(&reversed).unwrap()));
    });
}

#[test]
fn pairs_are_seen_together_and_ranked_by_the_classifier() {
    with_generator(&config(SWEEPS), 0, |generator| {
        let sweep = &generator.config.sweeps[1];
        let scores = |max_agents: usize| -> Vec<f64> {
            let collator = Arc::new(Collator { max_agents, ..Collator::clone(&generator.collator) });
            let generator = Generator { collator, metric_settings: generator.metric_settings.clone(), ..*generator };
            let pairs = generator.candidates(sweep, generator.behavior(sweep).unwrap(), &scene(1)).unwrap();
            pairs.iter().map(|pair| pair.score).collect()
        };
        // Of two agents, one is the nearest of the one at the center.
        assert_eq!([scores(3).len(), scores(2).len()], [6, 3]);
        assert!(scores(3).is_sorted_by(|a, b| a > b) && scores(3).iter().all(|score| *score != 0.0), "{:?}", scores(3));
    });
}

#[test]
fn too_few_scenes_are_said_and_none_is_an_error() {
    let config = config(SWEEPS);
    with_generator(&config, 0, |generator| {
        let plan = generator.plan(&index(3)).unwrap();
        assert_eq!(plan.shortfalls[0], Shortfall { sweep: "plain".to_owned(), n_wanted: 5, n_found: 3 });
        let error = generator.plan(&SceneIndex::default()).unwrap_err().to_string();
        assert!(error.contains("sweep plain") && error.contains("generate.splits"), "{error}");
    });
}

#[test]
fn samples_that_are_no_numbers_are_rejected_by_name() {
    let config = config(SWEEPS);
    with_generator(&config, 1, |generator| {
        let plan = generator.plan(&index(12)).unwrap();
        let output = generator.generate(&plan.shards[0], &Silent).unwrap();
        assert!(output.records.is_empty());
        assert_eq!(output.rejected.len(), 15);
        let first = &output.rejected[0];
        assert_eq!((&first.scene_id, first.sample_idx), (&plan.shards[0].cells[0].scene_id, 0));
        assert!(
            matches!(&first.reason, Rejection::Unfit(why) if why.contains("not finite at timestep 4")),
            "{first:?}"
        );
    });
}

#[test]
fn models_must_fit_each_other_and_the_sweeps() {
    let refusal = |toml: &str, classifiers: &[TrainedClassifier]| {
        let (denoiser, behaviors) = (denoiser(0), drift());
        let config = resolve(toml);
        let models = Models { denoiser: &denoiser, classifiers, distilled: None, baseline: None };
        Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu)
            .err()
            .map(|error| error.to_string())
    };
    assert_eq!(refusal(SWEEPS, &[classifier()]), None);
    assert!(refusal(SWEEPS, &[]).unwrap().contains("no classifier for drift"));
    assert_eq!(refusal(&SWEEPS.replace("[0.0, 3.0]", "[0.0]"), &[]), None);
    let sampler = "n_scenes = 5\n    sampler = { kind = 'heun', n_steps = 4, grid = { sigma_max = 400 } }";
    let beyond = SWEEPS.replace("n_scenes = 5", sampler);
    assert!(refusal(&beyond, &[classifier()]).unwrap().contains("above the denoiser's largest, 80"));
    let mut foreign = classifier();
    foreign.spec.normalizer.motion_lateral_unit_m *= 1.01;
    assert!(refusal(SWEEPS, &[foreign]).unwrap().contains("different normalization"));
}

#[test]
fn a_distilled_denoiser_is_asked_at_its_own_noise_levels() {
    let refused = |distillation: Option<Distillation>, rest: &str, change: fn(&mut DenoiserSpec)| {
        let (denoiser, mut distilled) = (denoiser(0), denoiser(0));
        distilled.spec.distillation = distillation;
        change(&mut distilled.spec);
        let config = resolve(&format!("[[sweeps]]\nname = 'a'\nn_scenes = 2\nmodel = 'distilled'\n{rest}"));
        let models = Models { denoiser: &denoiser, classifiers: &[], distilled: Some(&distilled), baseline: None };
        Generator::new(&config, models, &[], &load, MetricSettings::default(), &Device::Cpu)
            .err()
            .map(|error| error.to_string())
    };
    let refusal = |distillation: Option<Distillation>, rest: &str| refused(distillation, rest, |_| {});
    let steps = || Some(Distillation::Steps { sigmas: vec![30.0, 2.0, 0.0] });
    let euler = |last: f64| {
        format!("sampler = {{ kind = 'euler', n_steps = 2, grid = {{ sigma_max = 30, sigma_min = {last} }} }}")
    };
    assert_eq!(refusal(steps(), &euler(2.0)), None);
    for (distillation, sampler, part) in [
        (steps(), euler(3.0), "[30.0, 2.0, 0.0], the sweep through [30.0, 3.0, 0.0]"),
        (None, euler(2.0), "train.distill.checkpoint is an ordinary denoiser"),
    ] {
        let message = refusal(distillation, &sampler).unwrap();
        assert!(message.contains("sweep a") && message.contains(part), "{message}");
    }
    let changes: [fn(&mut DenoiserSpec); 3] = [
        |spec| spec.edm.sigma_max = 40.0,
        |spec| spec.n_timesteps += 1,
        |spec| spec.normalizer.motion_lateral_unit_m *= 1.01,
    ];
    for change in changes {
        let message = refused(steps(), &euler(2.0), change).unwrap();
        assert!(message.contains("different scales or timesteps than the denoiser"), "{message}");
    }
    // Edits begin at one of its levels.
    assert_eq!(refusal(steps(), &format!("{}\nedit = {{ tau = 2.0 }}", euler(2.0))), None);
    let between = refusal(steps(), &format!("{}\nedit = {{ tau = 5.0 }}", euler(2.0))).unwrap();
    assert!(between.contains("edits a tau"), "{between}");
    // A distilled one in place of the denoiser.
    let mut denoiser = denoiser(0);
    denoiser.spec.distillation = steps();
    let config = resolve("[[sweeps]]\nname = 'a'\nn_scenes = 2");
    let models = Models { denoiser: &denoiser, classifiers: &[], distilled: None, baseline: None };
    let message =
        Generator::new(&config, models, &[], &load, MetricSettings::default(), &Device::Cpu).err().unwrap().to_string();
    assert!(message.contains("the denoiser is distilled"), "{message}");
}
