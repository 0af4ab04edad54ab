//! A denoiser that is conditioned on mined events: which events count, what a batch sees, and that it learns from them.

use super::scene_draws::Entry;
use super::testing::{MadeScenes, arcs, collator, draws_of_four, fork, job, one_source};
use super::*;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::model::{DenoiserSpec, GeometryConfig, NetworkConfig};
use crate::nn::testing::values;
use crate::nn::{Checkpoint, read_checkpoint};
use crate::scene::Scene;
use crate::scene::testing::Drive;
use crate::seed::Seed;
use crate::tensor::{Collator, MaskSampler, ONSET, Sight, StateParametrization, TaskWeights};
use candle_core::Device;
use std::path::Path;

const BEHAVIORS: [&str; 2] = ["lane_change", "near_miss"];

/// An event from `start` on; the present is timestep 3.
fn event(behavior: &str, label: EventLabel, start: usize, side: f64, scene: &Scene) -> BehaviorEvent {
    let roles: &[&str] = if behavior == "near_miss" { &["first", "second"] } else { &["agent"] };
    let agents: &[usize] = if roles.len() > 1 { &[1, 0] } else { &[1] };
    BehaviorEvent::new((behavior, roles), scene, label, agents, start..=11).with("side", side)
}

/// Scenes in which the second car bears left or right, a choice that only the event gives away, and an event for each.
fn forks(n: usize) -> (MadeScenes<impl Fn(usize) -> Scene + Sync>, Vec<BehaviorEvent>) {
    let scenes = MadeScenes(n, |idx: usize| fork(idx, &[Drive::straight(0.0, 20.0, 0.0, 9.0)]));
    let made = |idx: usize| {
        let side = if idx.is_multiple_of(2) { 1.0 } else { -1.0 };
        event(BEHAVIORS[usize::from(idx.is_multiple_of(5))], EventLabel::Positive, 5, side, &scenes.scene(idx).unwrap())
    };
    let events = (0..n).map(made).collect();
    (scenes, events)
}

fn config() -> EventTraining {
    EventTraining { behaviors: BEHAVIORS.map(str::to_owned).to_vec(), share: 0.5, value_dropout: 0.2 }
}

fn training(steps: u64, events: Option<EventTraining>) -> DenoiserTraining {
    let network = NetworkConfig {
        layers: "TA".to_owned(),
        width: 16,
        n_heads: 2,
        feed_forward: 32,
        geometry: Some(GeometryConfig { relation_width: 8, ..GeometryConfig::default() }),
        ..NetworkConfig::default()
    };
    let config = DenoiserTrainingConfig {
        preset: Preset::Tiny,
        network: Some(network),
        steps: Some(steps),
        learning_rate: Some(5e-3),
        batch_size: Some(8),
        evaluate_every: Some(steps),
        save_every: Some(5),
        n_eval_scenes: Some(8),
        events,
        ..DenoiserTrainingConfig::default()
    };
    config.resolve().unwrap()
}

fn data<'a>(dataset: &'a dyn SceneDataset, events: &'a [BehaviorEvent]) -> TrainingData<'a> {
    let mined = events.iter().enumerate().map(|(scene_idx, event)| MinedEvent { scene_idx, event });
    TrainingData { events: mined.collect(), ..one_source(dataset) }
}

fn gather(data: &TrainingData<'_>) -> LearnedEvents {
    LearnedEvents::gather("train.denoiser", &config(), data, (4, 0.1), 4, Seed(1)).unwrap()
}

#[test]
fn positive_events_after_the_present_count() {
    let (scenes, mut events) = forks(28);
    let all = gather(&data(&scenes, &events));
    // Every fifth of 20 training scenes has a near miss; of 8 held-out ones scene 20 and 25.
    assert_eq!(all.by_behavior.iter().map(Vec::len).collect::<Vec<_>>(), [16, 4]);
    let held_out: Vec<usize> = all.held_out.iter().map(|event| event.scene_idx).collect();
    assert!(held_out.len() == 4 && held_out.iter().all(|idx| (20..28).contains(idx)), "{held_out:?}");
    assert_eq!(held_out.iter().filter(|idx| idx.is_multiple_of(5)).count(), 2, "behaviors take turns: {held_out:?}");
    // From timestep 3 to timestep 5 of 0.1 s.
    assert!((all.events[0].values[ONSET] - 0.2).abs() < 1e-9);
    let known = &all.vocabulary.behaviors[1];
    assert_eq!((known.roles.len(), known.n_events, known.examples.len()), (2, 4, 4));
    // The first role is the car at 15 m/s, seen from which the other lies 20 m to the left.
    let present = &known.examples[0].present;
    assert!((present[0] - 15.0).abs() < 0.1 && (present[3] - 20.0).abs() < 0.1, "{present:?}");

    events[1].start_timestep = 3;
    events[2].label = EventLabel::Negative;
    events[3].start_timestep = 4;
    let fewer: Vec<usize> = gather(&data(&scenes, &events)).events.iter().map(|event| event.scene_idx).collect();
    assert_eq!(fewer[..3], [0, 3, 4]);
    events.iter_mut().filter(|event| event.behavior == "near_miss").for_each(|event| event.start_timestep = 0);
    let error = LearnedEvents::gather("train.denoiser", &config(), &data(&scenes, &events), (4, 0.1), 4, Seed(1))
        .unwrap_err()
        .to_string();
    assert!(error.contains("behaviors.1 is \"near_miss\", but no training scene"), "{error}");
}

fn seeing(dataset: &dyn SceneDataset) -> Collator {
    Collator { sight: Some(Sight::new(12)), ..collator(dataset, StateParametrization::Motion) }
}

#[test]
fn a_share_of_each_batch_is_told_and_behaviors_take_turns() {
    let (scenes, events) = forks(28);
    let events = gather(&data(&scenes, &events));
    let (collator, masks) = (seeing(&scenes), MaskSampler::new(&TaskWeights::default()).unwrap());
    let train = [WeightedGroups::single((0..20).collect())];
    let draws = SceneDraws { events: Some(&events), ..draws_of_four(&scenes, &train, &collator, &masks) };
    let entries: Vec<Entry<'_>> = (0..20).flat_map(|step| draws.batch_entries(step)).collect();
    let told: Vec<&LearnedEvent> =
        entries.iter().filter_map(|entry| if let Entry::Event(event) = entry { Some(*event) } else { None }).collect();
    assert_eq!((entries.len(), told.len()), (80, 40));
    // The 4 near misses come as often as the 16 lane changes, and each of them as often as the others.
    let n_of = |idx: usize| told.iter().filter(|event| event.scene_idx == idx).count();
    assert_eq!([0, 5, 10, 15].map(n_of), [5; 4]);
    let (mut n_values, mut n_rows) = (0.0, 0.0);
    for step in 0..200 {
        let drawn = draws.training_batch(step).unwrap();
        let inputs = drawn.batch.events.as_ref().unwrap();
        for (row, entry) in draws.batch_entries(step).iter().enumerate() {
            let of_row: Vec<f64> = values(&inputs.get(row).unwrap());
            let Entry::Event(event) = entry else {
                assert!(of_row.iter().all(|input| *input == 0.0), "ordinary scenes are told nothing");
                continue;
            };
            let frame = &drawn.batch.frames[row];
            assert_eq!(frame.ego_slot(), frame.slot(1), "the first agent of the event is at the center");
            // Lane changes have one role of 1 + 2 · 2 inputs, and near misses two.
            let first = 15 + usize::from(event.behavior == "near_miss") * 5;
            assert_eq!(of_row[first], 1.0);
            n_rows += 1.0;
            n_values += of_row[first + 1] + of_row[first + 3];
        }
    }
    // Each of two values is shown with probability 0.8 · 0.8; three standard deviations of 400 rows.
    let share: f64 = n_values / n_rows;
    assert!((share - 1.28).abs() < 3.0 * (2.0f64 * 0.64 / n_rows).sqrt(), "{share} values of {n_rows} rows");
}

#[test]
fn a_told_batch_knows_nothing_else_of_the_future() {
    // Two scenes with the same past; the car bears left in one and right in the other.
    let (scenes, events) = forks(28);
    let mut learned = gather(&data(&scenes, &events));
    learned.config.value_dropout = 0.0;
    let masks = MaskSampler::new(&super::testing::ONLY_PREDICTIVE).unwrap();
    let (collator, train) = (seeing(&scenes), [WeightedGroups::single(vec![0])]);
    let known = |idx: usize| {
        let mut one = learned.clone();
        one.by_behavior = vec![one.by_behavior[0][..1].to_vec()];
        one.events[one.by_behavior[0][0]].scene_idx = idx;
        let draws = SceneDraws { events: Some(&one), ..draws_of_four(&scenes, &train, &collator, &masks) };
        let batch = draws.training_batch(0).unwrap().batch;
        let around = batch.surroundings.as_ref().unwrap();
        let inputs = [&batch.context, &batch.features, &batch.base, &batch.latent, &around.lanes, &around.attributes];
        let events = values(batch.events.as_ref().unwrap());
        assert!(events.iter().any(|input| *input != 0.0));
        (inputs.map(values), events, values(&batch.x0))
    };
    let (left, right) = (known(2), known(3));
    assert!(left.0 == right.0 && left.1 == right.1);
    assert_ne!(left.2, right.2, "what is to be generated differs");
}

fn train(
    start: Option<&Checkpoint<DenoiserSpec>>,
    (scenes, events): (&dyn SceneDataset, &[BehaviorEvent]),
    training: &DenoiserTraining,
    dir: &Path,
) -> Result<TrainOutcome<DenoiserSpec>, Error> {
    train_denoiser(training, &data(scenes, events), start, job(3, dir))
}

#[test]
fn what_is_told_is_learned_from_a_checkpoint_without_events_and_resumes() {
    let (scenes, events) = forks(40);
    let dirs: [_; 4] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    let read = |i: usize| read_checkpoint::<DenoiserSpec>(&dirs[i].path().join(MODEL_FILE), &Device::Cpu).unwrap();
    train(None, (&scenes, &[]), &training(30, None), dirs[0].path()).unwrap();
    let start = read(0);
    assert!(start.metadata.events.is_none());
    let further = training(150, Some(config()));
    let outcome = train(Some(&start), (&scenes, &events), &further, dirs[1].path()).unwrap();
    let evaluation = &outcome.statistics.last().unwrap().evaluation;
    let loss = |of: &str| evaluation[&format!("held_out_loss_at_sigma_3_of_{of}_events")];
    // Untold, the mean of left and right is the best answer.
    assert!(loss("told") < 0.85 * loss("untold"), "{} told, {} untold", loss("told"), loss("untold"));
    assert_eq!(outcome.spec.events.as_ref().unwrap().names(), "lane_change, near_miss");

    // Stopped after a while and resumed, it is the same; and it goes on with the same events, not with others.
    struct Failing<'a>(&'a dyn SceneDataset, std::sync::atomic::AtomicUsize);
    impl SceneDataset for Failing<'_> {
        fn len(&self) -> usize {
            self.0.len()
        }
        fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
            match self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed) {
                500.. => Err("gone".into()),
                _ => self.0.scene(idx),
            }
        }
    }
    assert!(train(Some(&start), (&Failing(&scenes, 0.into()), &events), &further, dirs[2].path()).is_err());
    assert!(dirs[2].path().join("state.safetensors").exists());
    let resumed = train(Some(&start), (&scenes, &events), &further, dirs[2].path()).unwrap();
    assert_eq!(resumed.fingerprint, outcome.fingerprint);

    let second = read(1);
    let kept = train(Some(&second), (&scenes, &[]), &training(1, None), dirs[3].path()).unwrap();
    assert_eq!(kept.spec.events, second.metadata.events, "inputs stay where they are not trained");
    let other = EventTraining { behaviors: vec!["near_miss".to_owned()], ..config() };
    let error = train(Some(&second), (&scenes, &events), &training(1, Some(other)), dirs[3].path()).unwrap_err();
    let expected = "was trained on the events lane_change, near_miss, train.denoiser.events.behaviors is near_miss";
    assert!(error.to_string().contains(expected), "{error}");
}

#[test]
fn sections_that_cannot_work_are_refused() {
    let refusal = |text: &str| {
        let config: DenoiserTrainingConfig = toml::from_str(text).unwrap();
        config.resolve().unwrap_err().to_string()
    };
    assert!(refusal("events = { behaviors = [] }").contains("train.denoiser.events.behaviors is empty"));
    let unknown = refusal("events = { behaviors = ['cut_in', 'drift'] }");
    assert!(unknown.contains("train.denoiser.events.behaviors.1 is \"drift\", expected one of cut_in, "), "{unknown}");
    assert!(refusal("events = { behaviors = ['cut_in', 'cut_in'] }").contains("already listed"));
    assert!(refusal("preset = 'paper'\nevents = { behaviors = ['cut_in'] }").contains("only the geometric network"));
    assert!(refusal("events = { behaviors = ['cut_in'], share = 1.0 }").contains("events.share is 1"));
}

#[test]
fn arcs_without_events_are_as_before() {
    let dataset = arcs(20);
    let dirs: [_; 2] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    let fingerprint =
        |dir: &Path| train_denoiser(&training(3, None), &one_source(&dataset), None, job(3, dir)).unwrap().fingerprint;
    assert_eq!(fingerprint(dirs[0].path()), fingerprint(dirs[1].path()));
}
