//! Checks every behavior against its example scenes in `tests/fixtures/behavior/<id>/`.

use super::{Case, cases_in, random_scene, transformed};
use crate::behavior::{ALL, BehaviorConfig, BehaviorEvent, EventLabel, Subject};
use crate::geometry::{Transform2, Vec2};
use crate::scene::{AgentClass, Scene, State, Track, Trajectory};
use std::collections::{BTreeMap, BTreeSet};

fn case(id: &str, name: &str, text: &str) -> Case {
    toml::from_str(text).unwrap_or_else(|error| panic!("{id}/{name}: {error}"))
}

/// Differences between the events found and those expected, in words.
fn differences(case: &Case, scene: &Scene, found: &[BehaviorEvent]) -> Vec<String> {
    let mut differences = Vec::new();
    if found.len() != case.events.len() {
        differences.push(format!("{} events instead of {}", found.len(), case.events.len()));
    }
    for (i, (event, expected)) in found.iter().zip(&case.events).enumerate() {
        let roles: BTreeMap<String, String> =
            event.roles.iter().map(|(role, id)| (role.clone(), id.0.clone())).collect();
        if (event.label, &roles) != (expected.label, &expected.roles) {
            differences.push(format!("event {i} is {:?} for {roles:?}", event.label));
        }
        for (name, found, expected) in [
            ("starts", event.start_timestep, expected.start_timestep),
            ("ends", event.end_timestep, expected.end_timestep),
        ] {
            if expected.is_some_and(|expected| expected != found) {
                differences.push(format!("event {i} {name} at {found}"));
            }
        }
        let subject = event.subject_idx(scene).map(|agent_idx| scene.tracks[agent_idx].id.0.clone());
        if expected.subject.is_some() && subject != expected.subject {
            differences.push(format!("event {i} has the subject {subject:?}"));
        }
        for (name, expected) in &expected.parameters {
            let found = event.parameters.get(name);
            if !found.is_some_and(|found| (found - expected).abs() <= 0.0051) {
                differences.push(format!("event {i} has {name} = {found:?}"));
            }
        }
        for name in expected.absent.iter().filter(|name| event.parameters.contains_key(*name)) {
            differences.push(format!("event {i} has {name}"));
        }
    }
    differences
}

#[test]
fn every_example_scene_holds_exactly_its_events() {
    let mut failures = Vec::new();
    for entry in ALL {
        for (name, text) in cases_in(&format!("behavior/{}", entry.id)) {
            let case = case(entry.id, &name, &text);
            let config = case.behavior.clone().unwrap_or_else(|| (entry.default_config)());
            assert_eq!(config.id(), entry.id, "{name} is in the folder of another behavior");
            let scene = case.scene.build(&name);
            let found = config.build().detect(&scene);
            let differences = differences(&case, &scene, &found);
            if !differences.is_empty() {
                failures.push(format!("{}/{name}: {}\n    found {found:#?}", entry.id, differences.join("; ")));
            }
            // Neither the place nor the direction of the frame matters.
            let moved = transformed(&scene, &Transform2::from_pose(Vec2::new(-431.0, 77.0), 2.1));
            let outline = |events: &[BehaviorEvent]| -> Vec<_> {
                events.iter().map(|e| (e.label, e.roles.clone(), e.start_timestep, e.end_timestep)).collect()
            };
            assert_eq!(outline(&config.build().detect(&moved)), outline(&found), "{}/{name} moved", entry.id);
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_behavior_is_listed_once_and_has_examples_of_both_labels() {
    let ids: BTreeSet<&str> = ALL.iter().map(|entry| entry.id).collect();
    assert_eq!(ids.len(), ALL.len());
    for entry in ALL {
        let config = (entry.default_config)();
        let behavior = config.build();
        assert_eq!((config.id(), behavior.id(), behavior.roles()), (entry.id, entry.id, entry.roles));
        assert_eq!(BehaviorConfig::from_id(entry.id), Some(config));
        let labels: BTreeSet<EventLabel> = cases_in(&format!("behavior/{}", entry.id))
            .iter()
            .flat_map(|(name, text)| case(entry.id, name, text).events)
            .map(|event| event.label)
            .collect();
        assert_eq!(labels.len(), 2, "{} lacks positive or negative example scenes", entry.id);
    }
}

#[test]
fn who_may_be_asked_is_motorized_unless_the_behavior_says_otherwise() {
    for entry in ALL {
        let behavior = (entry.default_config)().build();
        assert!(behavior.admits(AgentClass::Vehicle) && !behavior.admits(AgentClass::Static), "{}", entry.id);
        let is_of_all = ["near_miss", "collision", "pedestrian_steps_out"].contains(&entry.id);
        assert_eq!(behavior.admits(AgentClass::Pedestrian), is_of_all, "{}", entry.id);
    }
}

#[test]
fn examples_say_of_every_behavior_who_the_subject_is() {
    for entry in ALL {
        let events = |(name, text): &(String, String)| case(entry.id, name, text).events;
        let cases = cases_in(&format!("behavior/{}", entry.id));
        assert!(cases.iter().flat_map(events).any(|event| event.subject.is_some()), "{}", entry.id);
        if let Subject::Role(role) = entry.subject {
            assert!(entry.roles.contains(&role), "{}", entry.id);
        }
    }
}

/// The list has exactly the parameters that events have: requests may name no others.
#[test]
fn parameters_are_listed_and_occur_in_the_examples() {
    for entry in ALL {
        let mut found = BTreeSet::new();
        for (name, text) in cases_in(&format!("behavior/{}", entry.id)) {
            let case = case(entry.id, &name, &text);
            let config = case.behavior.clone().unwrap_or_else(|| (entry.default_config)());
            for event in config.build().detect(&case.scene.build(&name)) {
                found.extend(event.parameters.into_keys());
            }
        }
        let listed: BTreeSet<String> = entry.parameters.iter().map(|name| (*name).to_owned()).collect();
        assert_eq!(found, listed, "{}", entry.id);
    }
}

#[test]
fn configs_are_read_by_kind_and_refuse_unknown_options() {
    let read = |text: &str| toml::from_str::<BehaviorConfig>(text);
    for entry in ALL {
        assert_eq!(read(&format!("kind = {:?}", entry.id)).expect("defaults"), (entry.default_config)());
        let error = read(&format!("kind = {:?}\nno_such = 1", entry.id)).expect_err("unknown").to_string();
        assert!(error.contains("unknown field `no_such`"), "{error}");
    }
    assert!(read("kind = \"teleport\"").is_err());
    let json = serde_json::to_string(&schemars::schema_for!(BehaviorConfig)).expect("a schema");
    assert!(ALL.iter().all(|entry| json.contains(entry.id)) && json.contains("additionalProperties"));
}

/// The scene with `replace` in place of every seventh state.
fn with_holes(scene: &Scene, replace: Option<State>) -> Scene {
    let track = |(agent_idx, track): (usize, &Track)| {
        let state =
            |(t, state): (usize, &Option<State>)| if (t + agent_idx).is_multiple_of(7) { replace } else { *state };
        let states = track.trajectory.entries().iter().enumerate().map(state);
        Track { trajectory: Trajectory::new(states.collect()), ..track.clone() }
    };
    Scene { tracks: scene.tracks.iter().enumerate().map(track).collect(), ..scene.clone() }
}

#[test]
fn states_that_are_no_numbers_are_as_good_as_none() {
    let broken =
        State { position: Vec2::new(f64::NAN, 0.0), heading_rad: f64::INFINITY, velocity: Vec2::new(1.0, 0.0) };
    for entry in ALL {
        let behavior = (entry.default_config)().build();
        for seed in 0..10 {
            let scene = random_scene(seed, 9, 20.0);
            let [missing, broken] = [None, Some(broken)].map(|state| behavior.detect(&with_holes(&scene, state)));
            assert_eq!(missing, broken, "{}", entry.id);
        }
    }
}
