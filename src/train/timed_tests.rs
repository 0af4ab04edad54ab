//! A training that is given time ends in time, can be repeated by what it chose, and never gets worse.

use super::denoiser_tests::training;
use super::testing::{arcs, job, one_source};
use super::*;
use crate::model::DenoiserSpec;
use crate::nn::{Checkpoint, read_checkpoint};
use crate::progress::{Progress, Silent};
use candle_core::Device;
use fs_err as fs;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// The time for a test, on a clock that goes on by a hundredth of a second with each scene that is loaded.
const UNTIL_S: f64 = 28.0;

/// Interrupts after this many looks whether to stop.
struct StopAfter(AtomicU64);

impl Progress for StopAfter {
    fn must_stop(&self) -> bool {
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err()
    }
}

fn within(learning_rates: &[f64]) -> DenoiserTraining {
    let scales = vec![Scales::Recordings, Scales::Checkpoint];
    let within = Within { seconds: UNTIL_S, learning_rates: learning_rates.to_vec(), scales, n_eval_scenes: None };
    DenoiserTraining { within: Some(within), ..training(1_000) }
}

/// Trains from `start`; returns the outcome and the time by then.
fn trained(
    training: &DenoiserTraining,
    start: &Checkpoint<DenoiserSpec>,
    (dir, progress): (&Path, &dyn Progress),
    until_s: f64,
) -> (Result<TrainOutcome<DenoiserSpec>, Error>, f64) {
    let (scenes, loaded) = (arcs(48), AtomicU64::new(0));
    let counted = testing::MadeScenes(48, |idx| {
        loaded.fetch_add(1, Ordering::Relaxed);
        scenes.scene(idx).unwrap()
    });
    let clock_s = || loaded.load(Ordering::Relaxed) as f64 * 0.01;
    let job = TrainJob { time: Some(JobTime { clock_s: &clock_s, until_s }), progress, ..job(3, dir) };
    let outcome = train_denoiser(training, &one_source(&counted), Some(start), job);
    (outcome, clock_s())
}

fn start(dir: &Path) -> Checkpoint<DenoiserSpec> {
    train_denoiser(&training(60), &one_source(&arcs(40)), None, job(3, dir)).unwrap();
    read_checkpoint(&dir.join(MODEL_FILE), &Device::Cpu).unwrap()
}

#[test]
fn what_was_chosen_for_a_time_brings_the_same_bytes_and_an_interruption_changes_nothing() {
    let [first, whole, stopped, explicit, cut] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    let start = start(first.path());
    let config = within(&[1e-7, 5e-3]);
    let (outcome, ended_s) = trained(&config, &start, (whole.path(), &Silent), UNTIL_S);
    let outcome = outcome.unwrap();
    assert!(ended_s > 0.85 * UNTIL_S && ended_s < 1.05 * UNTIL_S, "{ended_s}");
    let chosen: Chosen = serde_json::from_slice(&fs::read(whole.path().join(CHOSEN_FILE)).unwrap()).unwrap();
    // Hardly anything is learned at the lower rate.
    assert_eq!((chosen.learning_rate, outcome.spec.steps), (5e-3, chosen.steps));
    let tried: Vec<(Scales, f64)> = chosen.tried.iter().map(|tried| (tried.scales, tried.learning_rate)).collect();
    let (own, other) = (Scales::Recordings, Scales::Checkpoint);
    assert_eq!(tried, [(own, 1e-7), (other, 1e-7), (chosen.scales, 5e-3)]);
    let minutes: Vec<f64> = outcome.statistics.iter().filter_map(|line| line.minutes).collect();
    assert!(minutes.len() > 2 && minutes.is_sorted() && minutes[minutes.len() - 1] < UNTIL_S / 60.0, "{minutes:?}");
    let errors = outcome.statistics.iter().filter_map(|line| line.evaluation.get(SCENE_ERROR));
    let errors: Vec<f64> = errors.copied().collect();
    assert!(errors.iter().copied().fold(f64::INFINITY, f64::min) < 0.9 * errors[0], "{errors:?}");

    let same = chosen.settings(&training(1_000));
    let same = train_denoiser(&same, &one_source(&arcs(48)), Some(&start), job(3, explicit.path())).unwrap();
    assert_eq!(same.fingerprint, outcome.fingerprint);

    // The trials take some 30 steps each.
    let stop = StopAfter(AtomicU64::new(200));
    let (interrupted, _) = trained(&config, &start, (stopped.path(), &stop), UNTIL_S);
    assert!(matches!(interrupted, Err(Error::Stopped { step: 1.. })), "{interrupted:?}");
    // Opening everything again takes time, too.
    let (resumed, _) = trained(&config, &start, (stopped.path(), &Silent), 1.2 * UNTIL_S);
    assert_eq!(resumed.unwrap().fingerprint, outcome.fingerprint);

    // What was chosen takes longer than there is time.
    fs::write(cut.path().join(CHOSEN_FILE), serde_json::to_vec(&Chosen { steps: 10_000, ..chosen }).unwrap()).unwrap();
    let (outcome, ended_s) = trained(&config, &start, (cut.path(), &Silent), 4.0);
    assert!(outcome.unwrap().spec.steps < 200 && ended_s < 6.0, "{ended_s}");
}

#[test]
fn where_there_is_no_time_to_try_anything_the_first_settings_are_taken() {
    let [first, second] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    let start = start(first.path());
    let mut short = within(&[5e-3, 1e-3]);
    short.within.as_mut().unwrap().seconds = 10.0;
    let (outcome, ended_s) = trained(&short, &start, (second.path(), &Silent), 10.0);
    assert!(outcome.is_ok() && ended_s < 10.5, "{ended_s}");
    let chosen: Chosen = serde_json::from_slice(&fs::read(second.path().join(CHOSEN_FILE)).unwrap()).unwrap();
    assert_eq!((chosen.tried, chosen.scales, chosen.learning_rate), (Vec::new(), Scales::Recordings, 5e-3));
    assert!(chosen.began_m.is_some_and(|began_m| began_m > 0.0));
}

#[test]
fn a_training_that_makes_scenes_worse_ends_with_the_checkpoint_as_it_was() {
    let [first, second] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    let start = start(first.path());
    let mut spoiling = within(&[1.0]);
    spoiling.within.as_mut().unwrap().scales = vec![Scales::Checkpoint];
    let (outcome, _) = trained(&spoiling, &start, (second.path(), &Silent), UNTIL_S);
    let outcome = outcome.unwrap();
    let errors = outcome.statistics.iter().filter_map(|line| line.evaluation.get(SCENE_ERROR));
    let errors: Vec<f64> = errors.copied().collect();
    assert!(errors.len() > 2 && errors[1..].iter().all(|error| *error > errors[0]), "{errors:?}");
    assert_eq!(outcome.fingerprint, start.fingerprint);
}

#[test]
fn a_time_is_read_from_words_and_decides_what_is_left_out() {
    let config = |text: &str| DenoiserTrainingConfig {
        time: Some(text.to_owned()),
        start_from: Some("model.safetensors".into()),
        ..DenoiserTrainingConfig::default()
    };
    let resolved = config("1h 30 min").resolve().unwrap();
    let within = resolved.within.unwrap();
    assert_eq!((within.seconds, within.n_eval_scenes, within.scales.len()), (5400.0, None, 2));
    assert_eq!((within.learning_rates, resolved.common.tasks.predictive), (vec![4e-4, 4e-4 / 3.0], 80.0));
    let own = |rate: f64| DenoiserTrainingConfig { learning_rate: Some(rate), ..config("3 min") };
    assert_eq!(own(1e-3).resolve().unwrap().within.unwrap().learning_rates, [1e-3]);
    let kept = DenoiserTrainingConfig { scales: Some(Scales::Checkpoint), n_eval_scenes: Some(7), ..config("3 min") };
    let kept = kept.resolve().unwrap().within.unwrap();
    assert_eq!((kept.scales, kept.n_eval_scenes), (vec![Scales::Checkpoint], Some(7)));
    let more = MoreScenes { scenes: "more".into(), weight: 2.0 };
    let mixed = DenoiserTrainingConfig { data: vec![more], ..config("3 min") };
    assert_eq!(mixed.mixture(OwnScenes::default()).own_weight, 6.0);
    assert_eq!(config("3 min").mixture(OwnScenes::default()).own_weight, 1.0);
    let steps = DenoiserTrainingConfig { steps: Some(100), ..config("3 min") };
    for (wrong, told) in [
        (config("30"), "for is \"30\", expected a time such as"),
        (config("1 s"), "expected 10 s to 60 days"),
        (steps, "for goes without `steps`"),
    ] {
        let error = wrong.resolve().unwrap_err().to_string();
        assert!(error.contains(told) && error.contains("train.denoiser"), "{error}");
    }
}
