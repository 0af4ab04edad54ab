//! Does the classifier learn what separates its examples, and does guidance by it push toward the behavior?

use super::testing::{MadeScenes, job};
use super::*;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::diffusion::NoiseDistribution;
use crate::guidance::testing::{N_HISTORY, denoiser_spec, is_positive, scene};
use crate::guidance::{ClassifierGuidance, ClassifierPotential, Guidance, log_potential_gradient};
use crate::model::{DenoiserSpec, ModelSpec, TrainedClassifier};
use crate::nn::testing::{scalar, values};
use crate::nn::{Compute, Params};
use crate::progress::{Progress, Silent};
use crate::scene::{Roles, Scene};
use crate::seed::Seed;
use crate::store::testing::event as event_of;
use crate::tensor::{FutureValidity, StateParametrization};
use candle_core::{Device, Tensor};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Scenes, some of which hold a cut-in.
const fn scenes(n: usize) -> MadeScenes<fn(usize) -> Scene> {
    MadeScenes(n, scene)
}

fn event(idx: usize, label: EventLabel) -> BehaviorEvent {
    let roles = Roles::from([("ego", "behind"), ("other", "ahead")]);
    BehaviorEvent { label, roles, ..event_of(&scene(idx).id, "cut_in", &[]) }
}

fn pairs(indices: std::ops::Range<usize>, max_pairs: usize) -> Vec<LabeledPair> {
    let label = |idx| if is_positive(idx) { EventLabel::Positive } else { EventLabel::Negative };
    let events: Vec<(usize, BehaviorEvent)> = indices.map(|idx| (idx, event(idx, label(idx)))).collect();
    let mined: Vec<MinedEvent<'_>> =
        events.iter().map(|(scene_idx, event)| MinedEvent { scene_idx: *scene_idx, event }).collect();
    LabeledPair::of_events(&mined, max_pairs, Seed(2))
}

fn examples(pairs: &[LabeledPair]) -> PairExamples {
    PairExamples::gather(&scenes(1000), pairs).unwrap()
}

fn train(denoiser: &DenoiserSpec, steps: u64, dir: &Path, progress: &dyn Progress) -> Result<ClassifierReport, Error> {
    let (train, held_out) = (pairs(0..240, 1000), pairs(240..400, 1000));
    let data = PairData {
        roles: vec!["ego".to_owned(), "other".to_owned()],
        dataset: &scenes(1000),
        train: &train,
        held_out: &held_out,
        fingerprint: "events".to_owned(),
    };
    let config =
        ClassifierTrainingConfig { steps, batch_size: 32, evaluate_every: 50, ..ClassifierTrainingConfig::default() };
    let job = TrainJob { progress, ..job(4, dir) };
    train_classifier(&config, denoiser, &data, job)
}

#[test]
fn it_separates_the_better_the_less_noise_there_is() {
    for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
        let dir = tempfile::tempdir().unwrap();
        let report = train(&denoiser_spec(parametrization), 150, dir.path(), &Silent).unwrap();
        assert_eq!((report.spec.n_positive, report.spec.n_negative, report.spec.pos_weight), (60, 180, 3.0));
        let auc: Vec<f64> = report.by_noise_level.iter().map(|level| level.auc.unwrap()).collect();
        assert!(auc[0] > 0.97 && auc[1] > 0.97, "{parametrization:?}: {auc:?}");
        assert!(auc[5] < auc[3] - 0.1, "{parametrization:?}: {auc:?}");
        let clear = &report.by_noise_level[0];
        assert_eq!((clear.n_positive, clear.n_negative), (40, 120));
        assert!(clear.recall.unwrap() > 0.9 && clear.precision.unwrap() > 0.8, "{clear:?}");
        let written: ClassifierReport =
            serde_json::from_slice(&fs_err::read(dir.path().join("classifier.json")).unwrap()).unwrap();
        assert_eq!((written.fingerprint, written.by_noise_level.len()), (report.fingerprint, REPORT_SIGMAS.len()));
    }
}

/// With logits of 1 throughout, a positive example costs ln(1 + 1/e) and a negative one ln(1 + e). A quarter of the
/// examples are positive.
#[test]
fn labels_count_as_in_uniform_draws_times_the_weight_of_positive_ones() {
    let (dir, examples) = (tempfile::tempdir().unwrap(), examples(&pairs(0..240, 1000)));
    let denoiser = denoiser_spec(StateParametrization::Motion);
    for (pos_weight, share_of_positive) in [(1.0, 0.25), (3.0, 0.5), (9.0, 0.75)] {
        let spec = train(&denoiser, 1, dir.path(), &Silent).unwrap().spec;
        let mut params = Params::new(&Compute::cpu());
        let classifier = spec.build(&mut params, Seed(1)).unwrap();
        let constant = params.tensors().into_iter().map(|(name, tensor)| {
            let value = if tensor.dims() == [1] { tensor.ones_like() } else { tensor.zeros_like() };
            (name, value.unwrap())
        });
        params.load(&constant.collect()).unwrap();
        let noise = NoiseDistribution::default();
        let inputs = NoisyPairs { spec: &spec, noise, train: &examples, held_out: &examples, device: &Device::Cpu };
        let task = ClassificationTask {
            classifier: &classifier,
            frozen: &classifier,
            inputs: &inputs,
            pos_weight,
            batch_size: 16,
            seed: Seed(6),
            ahead: Mutex::default(),
        };
        let expected = share_of_positive * (-1f64).exp().ln_1p() + (1.0 - share_of_positive) * 1f64.exp().ln_1p();
        let loss = scalar(&task.loss(0).unwrap());
        assert!((loss - expected).abs() < 1e-5, "weight {pos_weight}: {loss}, expected {expected}");
    }
}

#[test]
fn a_killed_training_resumes_to_the_same_weights() {
    /// Unwinds at the n-th step of a call, as abruptly as a killed process.
    struct Kill(AtomicU64);
    impl Progress for Kill {
        fn advance(&self, _n: u64) {
            assert!(self.0.fetch_sub(1, Ordering::Relaxed) > 1, "killed");
        }
    }
    let denoiser = denoiser_spec(StateParametrization::Motion);
    let (whole, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let undisturbed = train(&denoiser, 30, whole.path(), &Silent).unwrap();
    for after in [4, 9, 13] {
        let run = || train(&denoiser, 30, killed.path(), &Kill(AtomicU64::new(after)));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
    }
    let resumed = train(&denoiser, 30, killed.path(), &Silent).unwrap();
    let found = (resumed.fingerprint, resumed.by_noise_level, resumed.statistics.len());
    assert_eq!(found, (undisturbed.fingerprint, undisturbed.by_noise_level, undisturbed.statistics.len()));
    let read = |dir: &Path| fs_err::read(dir.join("model.safetensors")).unwrap();
    assert_eq!(read(killed.path()), read(whole.path()));
}

#[test]
fn its_gradient_pushes_the_second_agent_toward_the_first() {
    for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
        let denoiser = denoiser_spec(parametrization);
        let dir = tempfile::tempdir().unwrap();
        train(&denoiser, 150, dir.path(), &Silent).unwrap();
        let trained = TrainedClassifier::read(&dir.path().join("model.safetensors"), &Compute::cpu()).unwrap();
        // Held-out scenes in which nothing happens.
        let scenes = [401, 402, 403].map(|idx| Scene { ego_idx: 1, ..scene(idx) });
        let batch = denoiser.collator().predictive(&scenes.each_ref(), FutureValidity::Everything);
        let pairs = trained.spec.features(&batch, &[(1, 2); 3]).unwrap();
        let classifier = &trained.network;
        let potential = ClassifierPotential::LogProbability;
        let guidance = ClassifierGuidance { classifier, pairs, potential };
        let sigma = Tensor::new(&[0.1f32; 3], &Device::Cpu).unwrap();
        let gradient = log_potential_gradient(&guidance, &batch.x0, &sigma).unwrap();

        // Along its gradient the log probability grows as fast as the gradient is long (finite differences in f32).
        let value = |h: f64| {
            let x = (&batch.x0 + (&gradient * h).unwrap()).unwrap();
            scalar(&guidance.log_potential(&x, &sigma).unwrap().sum_all().unwrap())
        };
        let squared = scalar(&gradient.sqr().unwrap().sum_all().unwrap());
        let h = 1e-2 / squared.sqrt();
        let growth = (value(h) - value(-h)) / (2.0 * h);
        assert!((growth / squared - 1.0).abs() < 0.02, "growth {growth}, squared norm {squared}");

        // A step along it moves the second agent's future to the right, and the bystander not at all.
        let lateral = |x: &Tensor| batch.decode(x).unwrap().narrow(3, 1, 1).unwrap().squeeze(3).unwrap();
        let moved = (lateral(&(&batch.x0 + &gradient).unwrap()) - lateral(&batch.x0)).unwrap();
        let moved = values(&moved.mean_keepdim(2).unwrap().mean(0).unwrap());
        assert!(moved[0] == 0.0 && moved[2] < 0.0, "{parametrization:?}: {moved:?}");
        // Observed states have no gradient.
        let observed = gradient.narrow(2, 0, N_HISTORY).unwrap().abs().unwrap().sum_all().unwrap();
        assert_eq!(scalar(&observed), 0.0);
    }
}

#[test]
fn too_many_examples_lose_negative_ones_first() {
    let examples = examples(&pairs(0..40, 15));
    assert_eq!((examples.labels().positive().len(), examples.labels().negative().len()), (8, 7));
    assert_eq!(Labels::new(pairs(0..40, 35).iter().map(|pair| pair.is_positive).collect()).positive().len(), 10);
    let scene = &examples.examples()[0].scene;
    let ids: Vec<&str> = scene.tracks.iter().map(|track| track.id.0.as_str()).collect();
    assert_eq!((ids, scene.ego_idx, examples.examples()[0].pair), (vec!["behind", "ahead"], 0, (0, 1)));
}

#[test]
fn one_positive_event_makes_a_pair_positive() {
    let events = [event(1, EventLabel::Negative), event(1, EventLabel::Positive), event(2, EventLabel::Negative)];
    let mined: Vec<MinedEvent<'_>> =
        events.iter().zip([1, 1, 2]).map(|(event, scene_idx)| MinedEvent { scene_idx, event }).collect();
    let pairs = LabeledPair::of_events(&mined, 10, Seed(0));
    let found = pairs.iter().map(|pair| (pair.scene_idx, pair.is_positive)).collect::<Vec<_>>();
    assert_eq!(found, [(1, true), (2, false)]);
}

#[test]
fn missing_examples_and_tracks_are_named() {
    let only_negative = pairs(1..4, 10);
    let data = PairData {
        roles: Vec::new(),
        dataset: &scenes(10),
        train: &only_negative,
        held_out: &only_negative,
        fingerprint: String::new(),
    };
    let dir = tempfile::tempdir().unwrap();
    let config = ClassifierTrainingConfig::default();
    let denoiser = denoiser_spec(StateParametrization::Motion);
    let error = train_classifier(&config, &denoiser, &data, job(0, dir.path())).unwrap_err();
    assert!(error.to_string().contains("0 positive and 3 negative"), "{error}");

    let roles = Roles::from([("ego", "behind"), ("other", "stranger")]);
    let stranger = BehaviorEvent { roles, ..event(1, EventLabel::Negative) };
    let mined = [MinedEvent { scene_idx: 1, event: &stranger }];
    let error = PairExamples::gather(&scenes(10), &LabeledPair::of_events(&mined, 10, Seed(0))).unwrap_err();
    assert!(error.to_string().contains("no track stranger"), "{error}");
}
