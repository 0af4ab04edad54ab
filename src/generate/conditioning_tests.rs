//! Do samples keep what is observed, lean toward target states, and start from the edited recording?

use super::testing::*;
use super::*;
use crate::diffusion::SamplerConfig;
use crate::guidance::testing::{N_HISTORY, N_TIMESTEPS, scene};
use crate::scenario::ScenarioRecord;
use crate::scene::{Scene, State};
use crate::seed::Seed;
use crate::store::as_stored;
use crate::tensor::StateParametrization;

/// A sweep of three scenes with two samples each.
fn sweep(more: &str) -> GenerateConfig {
    config(&format!("splits = ['train']\n[[sweeps]]\nname = 'a'\nn_scenes = 3\nn_samples = 2\n{more}"))
}

fn recorded(record: &ScenarioRecord) -> Scene {
    as_stored(&scene(record.scenario.scene.source.case_id.parse().unwrap()))
}

/// Every state of a record beside the recorded one, and whether it was observed.
fn states(record: &ScenarioRecord) -> Vec<(State, State, bool)> {
    let recorded = recorded(record);
    let (scene, observed) = (&record.scenario.scene, &record.scenario.observed);
    (0..scene.tracks.len() * N_TIMESTEPS)
        .map(|i| (i / N_TIMESTEPS, i % N_TIMESTEPS))
        .map(|(a, t)| (*scene.state(a, t).unwrap(), *recorded.state(a, t).unwrap(), observed.is_observed(a, t)))
        .collect()
}

#[test]
fn under_every_mask_observed_states_are_kept_and_the_others_generated() {
    let tasks = ["goal_conditioned", "agent_conditioned", "ego_conditioned", "windowed", "upsampling", "imputation"];
    let rules = "[{ agents = 'all', times = 'history' }, { agents = { track = 'ahead' }, times = 'future' }]";
    let configs = tasks.iter().map(|task| (format!("'{task}'"), *task)).chain([(rules.to_owned(), "mask")]);
    for (observe, name) in configs {
        let records = generate(&sweep(&format!("observe = {observe}")));
        assert_eq!(records.len(), 6);
        for record in &records {
            assert_eq!(record.scenario.provenance.observation, name);
            let states = states(record);
            let n_observed = states.iter().filter(|(.., is_observed)| *is_observed).count();
            // Three agents are fully tracked, and the task shows all three.
            let is_whole = name == "agent_conditioned";
            assert!(n_observed > 0 && (n_observed == states.len()) == is_whole, "{name}: {n_observed}");
            for (generated, recorded, is_observed) in &states {
                assert_eq!(generated == recorded, *is_observed, "{observe}");
            }
        }
        // Samples of a scene share their mask.
        for pair in records.chunks(2) {
            assert_eq!(pair[0].scenario.observed, pair[1].scenario.observed);
            assert_eq!(pair[0].scenario.scene == pair[1].scenario.scene, name == "agent_conditioned");
        }
    }
}

#[test]
fn masks_do_not_depend_on_batches() {
    let reference = generate(&sweep("observe = 'imputation'"));
    let other = generate(&GenerateConfig { batch_size: 1, scenes_per_shard: 1, ..sweep("observe = 'imputation'") });
    for (a, b) in reference.iter().zip(&other) {
        assert_eq!((&a.scenario.id, &a.scenario.observed), (&b.scenario.id, &b.scenario.observed));
    }
    assert_ne!(reference[0].scenario.observed, reference[2].scenario.observed);
}

const GOALS: &str = "classifier_free = { extra = [{ agents = 'all', times = 'goal' }], goal_std_m = 0.0, weights =";

/// The mean distance of all agents to their recorded place at the last timestep, meters.
fn goal_distance_m(records: &[ScenarioRecord]) -> f64 {
    let distances: Vec<f64> = records
        .iter()
        .flat_map(|record| states(record).into_iter().skip(N_TIMESTEPS - 1).step_by(N_TIMESTEPS).collect::<Vec<_>>())
        .map(|(generated, recorded, _)| generated.position.distance(recorded.position))
        .collect();
    distances.iter().sum::<f64>() / distances.len() as f64
}

#[test]
fn weights_lead_from_ignoring_goals_to_reaching_them() {
    // Weights between 0 and 1 need small steps at low noise levels.
    let finely = |more: &str| {
        let sampler = SamplerConfig::heun(20);
        generate(&GenerateConfig { sampler, ..sweep(more) })
    };
    // An agent that is kept apart from others does not reach its goal to the millimeter.
    let records = finely(&format!("validity_strength = 0.0\n{GOALS} [0.0, 0.5, 1.0] }}"));
    let unguided = finely("validity_strength = 0.0");
    let of = |weight: f64| -> Vec<ScenarioRecord> {
        records.iter().filter(|r| r.scenario.provenance.guidance.level.weight == weight).cloned().collect()
    };
    assert_eq!(records.len(), 18);
    assert_eq!(of(0.0), unguided, "weight 0 is unguided sampling, to the bit");
    let distances = [0.0, 0.5, 1.0].map(|weight| goal_distance_m(&of(weight)));
    assert!(distances[0] > 1.5 * distances[1] && distances[1] > distances[2] && distances[2] < 1e-3, "{distances:?}");
    for record in of(1.0) {
        assert_eq!(record.scenario.provenance.guidance.kind, "classifier_free");
        assert_eq!(record.scenario.provenance.observation, "predictive");
        // Goals are targets, not observed.
        assert!(states(&record).iter().enumerate().all(|(i, (.., seen))| *seen == (i % N_TIMESTEPS < N_HISTORY)));
    }
}

#[test]
fn at_weight_one_samples_are_as_if_goals_were_observed() {
    // Places in the scene are the same numbers under every mask, and so is their noise. Both start from the recording
    // plus noise, because pure noise has its origin in the coordinates of its mask.
    let generate = |config: &GenerateConfig| generate_in(StateParametrization::Scene, config);
    let start = "edit = { tau = 2.0 }\nvalidity_strength = 0.0";
    let observe =
        "observe = [{ agents = 'all', times = 'history' }, { agents = { track = 'bystander' }, times = 'goal' }]";
    let goal = GOALS.replace("'all'", "{ track = 'bystander' }");
    let observed = generate(&sweep(&format!("{start}\n{observe}")));
    let wanted = generate(&sweep(&format!("{start}\n{goal} [1.0], mask_velocity = false }}")));
    let ignored = generate(&sweep(start));
    for ((a, b), c) in observed.iter().zip(&wanted).zip(&ignored) {
        // An untrained network moves the bystander to and fro on its way: after all observed states that is removed.
        let others = |record: &ScenarioRecord| Scene {
            tracks: record.scenario.scene.tracks.iter().filter(|track| track.id.0 != "bystander").cloned().collect(),
            ..record.scenario.scene.clone()
        };
        assert!(difference_m(&others(a), &others(b)) < ROUNDING_M);
        assert!(difference_m(&others(a), &others(c)) > 2.0 * ROUNDING_M, "the goal matters");
    }
}

#[test]
fn only_wanted_states_that_are_generated_are_displaced() {
    let (recorded, is_wanted) = (scene(1), |agent_idx: usize, timestep: usize| agent_idx == 1 && timestep > 2);
    let moved = conditioning::displaced(&recorded, 2.0, Seed(1), &is_wanted);
    let offset = |agent_idx: usize, timestep: usize| {
        let [from, to] = [&recorded, &moved].map(|scene| scene.state(agent_idx, timestep).unwrap().position);
        to - from
    };
    for i in 0..3 * N_TIMESTEPS {
        let (agent_idx, timestep) = (i / N_TIMESTEPS, i % N_TIMESTEPS);
        let is_moved = agent_idx == 1 && timestep >= N_HISTORY;
        let expected = if is_moved { offset(1, N_TIMESTEPS - 1) } else { crate::geometry::Vec2::ZERO };
        assert!(offset(agent_idx, timestep).distance(expected) < 1e-9, "{agent_idx} {timestep}");
    }
    assert!(offset(1, N_TIMESTEPS - 1).norm() > 0.1);
    // The past is not wanted, though rules say so.
    let of = |rules: &str| {
        let goals = GOALS.replace("extra = [", rules).replace("goal_std_m = 0.0", "goal_std_m = 1.0");
        let records = generate(&sweep(&format!("{goals} [1.0] }}")));
        records.into_iter().map(|record| record.scenario.scene).collect::<Vec<_>>()
    };
    assert!(of("extra = [{ agents = 'all', times = 'history' }, ") == of("extra = ["));
}

#[test]
fn uncertain_goals_are_drawn_once_for_each_agent_and_sample() {
    let uncertain = format!("{} [1.0] }}", GOALS.replace("goal_std_m = 0.0", "goal_std_m = 1.0"));
    let records = generate(&sweep(&uncertain));
    assert_eq!(records, generate(&sweep(&uncertain)));
    let goals: Vec<_> = records
        .iter()
        .flat_map(|record| states(record).into_iter().skip(N_TIMESTEPS - 1).step_by(N_TIMESTEPS).collect::<Vec<_>>())
        .map(|(generated, recorded, _)| generated.position - recorded.position)
        .collect();
    assert_eq!(goals.len(), 18);
    let mean_square = goals.iter().map(|d| d.x * d.x + d.y * d.y).sum::<f64>() / 36.0;
    // 36 squares of standard normal draws: mean 1, standard deviation √(2 / 36) = 0.24.
    assert!((mean_square - 1.0).abs() < 0.75, "{mean_square}");
    assert!(goals.windows(2).all(|pair| pair[0].distance(pair[1]) > 1e-3));
}

const SHIFT: &str = "edits = [{ kind = 'shift', agent = { track = 'ahead' }, left_m = -3.0, onset_s = 1.0 }] }";

#[test]
fn without_noise_the_edited_recording_comes_back() {
    for tau in ["0.0", "1e-4"] {
        for record in generate(&sweep(&format!("edit = {{ tau = {tau}, {SHIFT}"))) {
            let recorded = recorded(&record);
            assert_eq!(record.scenario.provenance.edit_tau, Some(tau.parse().unwrap()));
            for agent_idx in 0..3 {
                let last = N_TIMESTEPS - 1;
                let moved = record.scenario.scene.state(agent_idx, last).unwrap().position
                    - recorded.state(agent_idx, last).unwrap().position;
                // The shift is to the left of the recorded heading.
                let heading_rad = recorded.state(agent_idx, last).unwrap().heading_rad;
                let expected =
                    if agent_idx == 2 { crate::geometry::Vec2::new(0.0, -3.0) } else { crate::geometry::Vec2::ZERO };
                let difference = moved.distance(expected.rotated(heading_rad));
                assert!(difference < 0.02, "{tau}: agent {agent_idx}: {difference} m");
            }
        }
    }
}

#[test]
fn from_the_largest_noise_level_editing_is_ordinary_sampling() {
    let ordinary = generate(&sweep(""));
    let edited = generate(&sweep(&format!("edit = {{ tau = 80.0, {SHIFT}")));
    for (a, b) in ordinary.iter().zip(&edited) {
        assert_eq!(a.scenario.scene, b.scenario.scene);
        assert_ne!(a.scenario.id, b.scenario.id);
    }
    // More noise forgets more of the edit.
    let far = |tau: &str| {
        let records = generate(&sweep(&format!("edit = {{ tau = {tau}, {SHIFT}")));
        let distances = records
            .iter()
            .zip(&generate(&sweep(&format!("edit = {{ tau = 0.0, {SHIFT}"))))
            .map(|(a, b)| difference_m(&a.scenario.scene, &b.scenario.scene))
            .collect::<Vec<_>>();
        distances.iter().sum::<f64>()
    };
    assert!(far("0.01") < far("0.1") && far("0.1") < far("1.0"));
}

#[test]
fn edited_states_can_be_observed() {
    // A plan for one agent, written into the scene and shown; the others are sampled from scratch.
    let plan = "observe = [{ agents = 'all', times = 'history' }, { agents = { track = 'ahead' }, times = 'all' }]";
    for record in generate(&sweep(&format!("{plan}\nedit = {{ tau = 80.0, {SHIFT}"))) {
        let recorded = recorded(&record);
        let last = N_TIMESTEPS - 1;
        let offset_m = |agent_idx: usize| {
            let place = record.scenario.scene.state(agent_idx, last).unwrap().position;
            place.distance(recorded.state(agent_idx, last).unwrap().position)
        };
        assert!((offset_m(2) - 3.0).abs() < 1e-4 && offset_m(0) > 1e-2);
        assert!(record.scenario.observed.is_observed(2, last) && !record.scenario.observed.is_observed(0, last));
    }
}

#[test]
fn leaning_costs_a_second_evaluation_only_where_estimates_are_mixed() {
    let cost = |weights: &str| {
        let goals = "classifier_free = { extra = [{ agents = 'all', times = 'goal' }], weights =";
        sweep(&format!("{goals} {weights} }}")).resolve(&drift()).unwrap().sweeps[0].n_evaluations()
    };
    assert_eq!(cost("[2.0]"), 2 * cost("[0.0, 1.0]"));
}

#[test]
fn conditions_that_a_scene_or_denoiser_cannot_meet_are_refused() {
    for (more, part) in [
        ("observe = [{ agents = { track = 'nobody' }, times = 'all' }]", "has no observed state"),
        ("edit = { tau = 100.0 }", "at most the denoiser's largest noise level 80"),
        ("edit = { edits = [{ kind = 'scale_speed', agent = { track = 'x' }, factor = 1.0 }] }", "tracked at present"),
    ] {
        let error = with_generator_result(&sweep(more), |generator| {
            generator.plan(&index(12)).and_then(|plan| {
                plan.shards.iter().try_for_each(|shard| generator.generate(shard, &crate::progress::Silent).map(|_| ()))
            })
        });
        let message = error.unwrap_err().to_string();
        assert!(message.contains(part), "{more}: {message}");
    }
}
