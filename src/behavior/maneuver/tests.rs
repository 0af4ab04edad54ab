//! Maneuvers of all behaviors against their miners.

use super::{Driver, spread};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::testing::{
    fork, fork_with_oncoming, going_on, merging_side_road, side_road, stop_line, two_lanes,
};
use crate::behavior::{BehaviorConfig, EventLabel};
use crate::geometry::Vec2;
use crate::scene::testing::Drive;
use crate::scene::{AgentClass, LaneGraph, Scene, State, Trajectory};
use std::collections::{BTreeMap, BTreeSet};

fn drive(x: f64, y: f64, speed_mps: f64) -> Drive {
    Drive::straight(x, y, 0.0, speed_mps)
}

/// A scene for each behavior in which the agents can show it, with their indices in the order of the roles.
fn possible() -> Vec<(&'static str, Scene, Vec<usize>)> {
    let alone = || vec![drive(0.0, 0.0, 10.0)];
    let mut beside_the_road = going_on(&[drive(0.0, 0.0, 10.0), drive(32.0, -3.0, 0.0)], two_lanes());
    beside_the_road.tracks[1].class = AgentClass::Pedestrian;
    beside_the_road.tracks[1].extent = None;
    let crossing = [drive(0.0, 0.0, 8.0), Drive::straight(20.0, -20.0, std::f64::consts::FRAC_PI_2, 8.0)];
    vec![
        (
            "hard_brake",
            going_on(&[drive(0.0, 0.0, 10.0), drive(15.0, 0.0, 9.0), drive(36.0, 0.0, 1.0)], two_lanes()),
            vec![0],
        ),
        ("lane_change", going_on(&alone(), two_lanes()), vec![0]),
        ("cut_in", going_on(&[drive(0.0, 0.0, 10.0), drive(16.0, 3.5, 9.0)], two_lanes()), vec![0, 1]),
        ("left_turn", going_on(&[drive(8.0, 0.0, 7.0)], fork()), vec![0]),
        ("tailgating", going_on(&[drive(0.0, 0.0, 11.0), drive(17.0, 0.0, 10.0)], two_lanes()), vec![0, 1]),
        ("collision", going_on(&crossing, LaneGraph::default()), vec![0, 1]),
        (
            "cut_out",
            going_on(&[drive(0.0, 0.0, 12.0), drive(58.0, 0.0, 0.0), drive(15.0, 0.0, 12.0)], two_lanes()),
            vec![0, 1, 2],
        ),
        ("pedestrian_steps_out", beside_the_road, vec![0, 1]),
        (
            "unprotected_left_turn",
            going_on(&[drive(14.0, 0.0, 6.0), oncoming(62.0, 9.0)], fork_with_oncoming()),
            vec![0, 1],
        ),
        ("failure_to_yield", going_on(&from_the_side(-24.0, 8.0), side_road("yield")), vec![0, 1]),
        ("wrong_way", going_on(&alone(), fork_with_oncoming()), vec![0]),
        ("runs_stop_line", going_on(&[drive(-25.0, 0.0, 8.0)], stop_line()), vec![0]),
    ]
}

/// A vehicle on the side road, and one at this place and speed on the main road.
fn from_the_side(x: f64, speed_mps: f64) -> [Drive; 2] {
    [Drive::straight(0.0, -14.0, std::f64::consts::FRAC_PI_2, 5.0), drive(x, 0.0, speed_mps)]
}

/// A vehicle on the lane that comes toward the fork, to the left of the one that leads there.
fn oncoming(x: f64, speed_mps: f64) -> Drive {
    Drive::straight(x, 3.5, std::f64::consts::PI, speed_mps)
}

#[test]
fn the_miner_finds_what_templates_were_made_for_and_as_it_was_wanted() {
    // Cut-ins are solved without plans.
    for (id, scene, agents) in possible().into_iter().filter(|(id, ..)| *id != "cut_in") {
        let behavior = BehaviorConfig::from_id(id).unwrap().build();
        let plans = super::plans(&*behavior, &scene, &agents, 4);
        assert!(!plans.is_empty(), "{id}: nothing is planned");
        assert!(plans.windows(2).all(|pair| pair[0].outcome.effort() <= pair[1].outcome.effort()), "{id}");
        for plan in &plans {
            let named = behavior.template_parameters().iter();
            let wanted: BTreeMap<String, [f64; 2]> = named
                .filter_map(|name| Some(((*name).to_owned(), plan.outcome.get(name)?)))
                .map(|(name, value)| (name, [value - 1e-6, value + 1e-6]))
                .collect();
            assert!(!wanted.is_empty(), "{id}: {plan:?}");
            let template = behavior.template(&scene, &agents, &wanted, 3).unwrap();
            assert!(template.agents().take(agents.len()).eq(agents.iter().copied()), "{id}");
            let mut changed = scene.clone();
            template.apply(&mut changed);
            let tracks = agents.iter().map(|agent_idx| &scene.tracks[*agent_idx].id);
            let is_meant = |event: &crate::behavior::BehaviorEvent| {
                event.label == EventLabel::Positive && event.roles.tracks().eq(tracks.clone())
            };
            let event = behavior.detect(&changed).into_iter().find(is_meant).unwrap_or_else(|| panic!("{id}: nothing"));
            for (name, [least, most]) in &wanted {
                assert!(
                    (least..=most).contains(&&event.parameters[name]),
                    "{id}: {name} of {event:?}, wanted {wanted:?}"
                );
            }
        }
    }
}

#[test]
fn who_cannot_show_a_behavior_has_no_template() {
    let impossible = [
        ("hard_brake", going_on(&[drive(0.0, 0.0, 2.0), drive(8.0, 0.0, 0.0)], two_lanes()), vec![0]),
        // There is nothing to brake for.
        ("hard_brake", going_on(&[drive(0.0, 0.0, 10.0)], two_lanes()), vec![0]),
        // Nor for the one ahead, at which it would drive on close behind.
        ("hard_brake", going_on(&[drive(0.0, 0.0, 10.0), drive(15.0, 0.0, 9.0)], two_lanes()), vec![0]),
        ("lane_change", going_on(&[drive(0.0, 0.0, 10.0)], LaneGraph::default()), vec![0]),
        // Another vehicle drives beside.
        ("lane_change", going_on(&[drive(0.0, 0.0, 10.0), drive(0.0, 3.5, 10.0)], two_lanes()), vec![0]),
        ("left_turn", going_on(&[drive(8.0, 0.0, 22.0)], fork()), vec![0]),
        ("right_turn", going_on(&[drive(8.0, 0.0, 7.0)], fork()), vec![0]),
        ("tailgating", going_on(&[drive(0.0, 0.0, 5.0), drive(17.0, 0.0, 5.0)], two_lanes()), vec![0, 1]),
        ("collision", going_on(&[drive(0.0, 0.0, 10.0), drive(60.0, 0.0, 20.0)], LaneGraph::default()), vec![0, 1]),
        ("pedestrian_steps_out", going_on(&[drive(0.0, 0.0, 10.0), drive(32.0, -3.0, 0.0)], two_lanes()), vec![0, 1]),
        ("cut_in_paper", going_on(&[drive(0.0, 0.0, 10.0), drive(12.0, 3.5, 10.0)], two_lanes()), vec![0, 1]),
        // The line is behind, or there is none.
        ("runs_stop_line", going_on(&[drive(-4.0, 0.0, 8.0)], stop_line()), vec![0]),
        ("runs_stop_line", going_on(&[drive(-25.0, 0.0, 8.0)], side_road("yield")), vec![0]),
        // There is no oncoming lane, or the agent is too slow.
        ("wrong_way", going_on(&[drive(0.0, 0.0, 10.0)], two_lanes()), vec![0]),
        ("wrong_way", going_on(&[drive(0.0, 0.0, 1.0)], fork_with_oncoming()), vec![0]),
        // The vehicle on the main road has passed, or both have the right of way.
        ("failure_to_yield", going_on(&from_the_side(5.0, 8.0), side_road("yield")), vec![0, 1]),
        ("failure_to_yield", going_on(&from_the_side(-24.0, 8.0), side_road("right_of_way")), vec![0, 1]),
        // The oncoming vehicle has passed, or is far away; nobody turns.
        (
            "unprotected_left_turn",
            going_on(&[drive(14.0, 0.0, 6.0), oncoming(10.0, 9.0)], fork_with_oncoming()),
            vec![0, 1],
        ),
        (
            "unprotected_left_turn",
            going_on(&[drive(14.0, 0.0, 6.0), oncoming(140.0, 9.0)], fork_with_oncoming()),
            vec![0, 1],
        ),
        ("unprotected_left_turn", going_on(&[drive(14.0, 0.0, 6.0), oncoming(62.0, 9.0)], two_lanes()), vec![0, 1]),
    ];
    for (id, scene, agents) in impossible {
        let behavior = BehaviorConfig::from_id(id).unwrap().build();
        assert_eq!(behavior.template(&scene, &agents, &BTreeMap::new(), 0), None, "{id}");
        assert_eq!(behavior.feasible(&scene, &agents).is_empty(), id != "cut_in_paper", "{id}");
    }
}

#[test]
fn the_recorded_future_is_not_looked_at() {
    for (id, scene, agents) in possible() {
        let mut unknown = scene.clone();
        for track in &mut unknown.tracks {
            let known = |(t, state): (usize, &Option<State>)| state.filter(|_| t < scene.n_history);
            track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(known).collect());
        }
        let behavior = BehaviorConfig::from_id(id).unwrap().build();
        let template = |scene: &Scene| behavior.template(scene, &agents, &BTreeMap::new(), 1);
        assert_eq!(template(&scene), template(&unknown), "{id}");
        assert_eq!(behavior.feasible(&scene, &agents), behavior.feasible(&unknown, &agents), "{id}");
    }
}

#[test]
fn scenes_that_end_at_present_have_no_templates() {
    for (id, mut scene, agents) in possible() {
        scene.n_timesteps = scene.n_history;
        for track in &mut scene.tracks {
            track.trajectory = Trajectory::new(track.trajectory.entries()[..scene.n_history].to_vec());
        }
        let behavior = BehaviorConfig::from_id(id).unwrap().build();
        assert_eq!(behavior.template(&scene, &agents, &BTreeMap::new(), 0), None, "{id}");
        assert!(behavior.feasible(&scene, &agents).is_empty(), "{id}");
    }
}

#[test]
fn templates_stay_on_the_road_and_within_what_vehicles_can() {
    for (id, scene, agents) in possible().into_iter().filter(|(id, ..)| *id != "collision") {
        let behavior = BehaviorConfig::from_id(id).unwrap().build();
        for variant in 0..5 {
            let mut changed = scene.clone();
            behavior.template(&scene, &agents, &BTreeMap::new(), variant).unwrap().apply(&mut changed);
            for agent_idx in &agents {
                let states = changed.tracks[*agent_idx].trajectory.entries();
                let velocities: Vec<Vec2> = states.iter().flatten().map(|state| state.velocity).collect();
                let hardest = velocities.windows(2).map(|pair| (pair[1] - pair[0]).norm() / scene.dt_s);
                let hardest = hardest.fold(0.0, f64::max);
                assert!(hardest < 8.0f64.hypot(3.6), "{id}: {hardest} m/s²");
                let farthest = states.iter().flatten().map(|state| state.position.y).fold(0.0, f64::max);
                assert!(
                    ["left_turn", "pedestrian_steps_out", "unprotected_left_turn", "failure_to_yield"].contains(&id)
                        || farthest < 5.3,
                    "{id}: {farthest} m beside"
                );
            }
        }
    }
}

/// The agents' states in each of some templates for a scene, from the present on.
fn driven(id: &str, scene: &Scene, agents: &[usize]) -> Vec<Vec<Vec<State>>> {
    driven_by(id, scene, agents, agents)
}

/// The states of the agents `whose`, where `agents` have the roles.
fn driven_by(id: &str, scene: &Scene, agents: &[usize], whose: &[usize]) -> Vec<Vec<Vec<State>>> {
    let behavior = BehaviorConfig::from_id(id).unwrap().build();
    let template = |variant| {
        let mut changed = scene.clone();
        behavior.template(scene, agents, &BTreeMap::new(), variant)?.apply(&mut changed);
        let states = |agent_idx: &usize| {
            let entries = &changed.tracks[*agent_idx].trajectory.entries()[scene.current_timestep()..];
            entries.iter().map(|state| state.unwrap()).collect()
        };
        Some(whose.iter().map(states).collect())
    };
    (0..6).filter_map(template).collect()
}

#[test]
fn who_is_cut_off_or_sees_somebody_in_the_way_brakes() {
    let reacting = possible().into_iter().filter_map(|(id, scene, agents)| match id {
        "pedestrian_steps_out" => Some((id, scene, agents, 0)),
        "unprotected_left_turn" | "failure_to_yield" => Some((id, scene, agents, 1)),
        _ => None,
    });
    for (id, scene, agents, who) in reacting {
        let templates = driven(id, &scene, &agents);
        assert!(!templates.is_empty(), "{id}");
        for states in templates {
            let speeds: Vec<f64> = states[who].iter().map(State::speed_mps).collect();
            let most = speeds.iter().copied().fold(0.0, f64::max);
            assert!(speeds[speeds.len() - 1] < most - 0.2, "{id}: {speeds:?}");
        }
    }
    // At the same speed, but too close.
    let scene = going_on(&[drive(0.0, 0.0, 10.0), drive(9.0, 3.5, 10.0)], two_lanes());
    let length_m = scene.tracks[0].extent_or_nominal().length_m;
    let mut n_close = 0;
    for states in driven("cut_in", &scene, &[0, 1]) {
        let [own, other] = [&states[0], &states[1]].map(|states| states[states.len() - 1]);
        if other.position.x - own.position.x - length_m < 7.5 {
            // It may not have had the time to react.
            assert!(own.speed_mps() < other.speed_mps() + 0.1, "{own:?} {other:?}");
            n_close += usize::from(own.speed_mps() < other.speed_mps() - 0.3);
        }
    }
    assert!(n_close > 0);
}

#[test]
fn nobody_gains_speed_toward_who_comes_into_the_way() {
    let behavior = BehaviorConfig::from_id("failure_to_yield").unwrap().build();
    let mut n_plans = 0;
    for (x, speed_mps) in [(-26.0, 6.0), (-28.0, 7.0), (-30.0, 8.0), (-34.0, 9.0)] {
        let scene = going_on(&from_the_side(x, speed_mps), side_road("yield"));
        for plan in super::plans(&*behavior, &scene, &[0, 1], 200) {
            let mut changed = scene.clone();
            plan.template(&scene, &[0, 1]).unwrap().apply(&mut changed);
            let enters = behavior.detect(&changed)[0].start_timestep;
            let speed_mps = |timestep: usize| changed.state(1, timestep).unwrap().speed_mps();
            let before = enters.saturating_sub(8).max(scene.current_timestep());
            let gained_mps = speed_mps(enters) - speed_mps(before);
            assert!(gained_mps < 0.1, "from {x} m: {gained_mps} m/s");
            n_plans += 1;
        }
    }
    assert!(n_plans > 5, "{n_plans}");
}

#[test]
fn who_follows_closely_brakes_hard() {
    let behavior = BehaviorConfig::from_id("failure_to_yield").unwrap().build();
    let mut gentlest_mps2 = f64::INFINITY;
    for (x, speed_mps) in [(-26.0, 6.0), (-28.0, 7.0), (-30.0, 8.0), (-34.0, 9.0)] {
        let scene = going_on(&from_the_side(x, speed_mps), side_road("yield"));
        for plan in super::plans(&*behavior, &scene, &[0, 1], 200) {
            let mut changed = scene.clone();
            plan.template(&scene, &[0, 1]).unwrap().apply(&mut changed);
            let event = &behavior.detect(&changed)[0];
            let speeds: Vec<f64> =
                changed.tracks[1].trajectory.entries().iter().flatten().map(State::speed_mps).collect();
            let slows = speeds.windows(2).map(|pair| (pair[0] - pair[1]) / scene.dt_s).fold(0.0, f64::max);
            if event.parameters["pet_s"] < 0.6 && event.start_timestep + 15 < scene.n_timesteps {
                gentlest_mps2 = gentlest_mps2.min(slows);
            }
        }
    }
    assert!((2.5..9.0).contains(&gentlest_mps2), "{gentlest_mps2}");
}

#[test]
fn nobody_stops_behind_who_drives_on_ahead() {
    // It turns into the main road, and the vehicle that it cut off could stop within the scene.
    let behavior = BehaviorConfig::from_id("failure_to_yield").unwrap().build();
    let mut n_plans = 0;
    for (x, speed_mps) in [(-18.0, 6.0), (-22.0, 6.0), (-28.0, 8.0)] {
        let scene = going_on(&from_the_side(x, speed_mps), merging_side_road());
        for plan in super::plans(&*behavior, &scene, &[0, 1], 200) {
            let mut changed = scene.clone();
            plan.template(&scene, &[0, 1]).unwrap().apply(&mut changed);
            let speeds = changed.tracks[1].trajectory.entries().iter().flatten().map(State::speed_mps);
            let slowest_mps = speeds.fold(f64::INFINITY, f64::min);
            assert!(slowest_mps > 0.5, "{slowest_mps} m/s from {speed_mps}");
            n_plans += 1;
        }
    }
    assert!(n_plans > 0, "{n_plans}");
}

#[test]
fn who_heads_off_its_lane_turns_along_it_and_does_not_swing_back() {
    let mut n_found = 0;
    for (heading_rad, speed_mps, headway_s) in [(0.1, 8.0, 0.8), (-0.08, 12.0, 0.8), (0.2, 4.0, 1.5), (0.1, 8.0, 1.2)] {
        let ahead = drive(5.0 + headway_s * speed_mps, 0.0, speed_mps);
        let slow = drive(30.0 + headway_s * speed_mps, 0.0, 2.0);
        let scene = going_on(&[Drive::straight(0.0, 0.0, heading_rad, speed_mps), ahead, slow], two_lanes());
        let present = *scene.state(0, scene.current_timestep()).unwrap();
        for states in driven("hard_brake", &scene, &[0]) {
            let aside: Vec<f64> =
                states[0].iter().map(|state| (state.position.y - present.position.y) * heading_rad.signum()).collect();
            let back_m = aside.windows(2).map(|pair| pair[0] - pair[1]).fold(0.0, f64::max);
            assert!(back_m < 0.015, "{heading_rad}: {back_m} m back in a step");
            assert!(aside[aside.len() - 1] < 1.2, "{heading_rad}: {} m aside", aside[aside.len() - 1]);
            n_found += 1;
        }
    }
    assert!(n_found > 5, "{n_found}");
}

#[test]
fn who_is_over_the_line_comes_back_or_goes_on_to_the_lane_beside() {
    // The lanes are 3.5 m apart, in the middle at y = 0 and 3.5.
    for (y, heading_rad, speed_mps, middle) in [(1.5, 0.0, 10.0, 0.0), (1.0, 0.06, 10.0, 3.5), (2.4, -0.05, 12.0, 0.0)]
    {
        let scene = going_on(&[Drive::straight(0.0, y, heading_rad, speed_mps)], two_lanes());
        let driver = super::Driver::new(&scene, &SceneLanes::new(&scene.lanes), 0).unwrap();
        assert!(!driver.rails.is_empty(), "{y}");
        for rail in 0..driver.rails.len() {
            let travel = driver.travel(rail, &super::Pace::steady(0.0));
            let positions = driver.positions(rail, &travel.driven_m);
            let aside: Vec<f64> = positions.iter().map(|at| (at.y - middle).abs()).collect();
            let farther_m = aside.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
            let last_m = aside[aside.len() - 1];
            assert!(last_m < 0.85 * aside[0] && farther_m < 0.02, "{y}, {heading_rad}: {last_m} m, {farther_m} m away");
        }
    }
}

#[test]
fn who_is_in_a_bend_does_not_straighten_before_it_goes_on() {
    // It turns left already where its lane does not yet, at 0.6 m/s².
    let mut scene = going_on(&[Drive::straight(0.0, 0.0, 0.0, 8.0)], two_lanes());
    let now = *scene.state(0, scene.current_timestep()).unwrap();
    let past = (0..scene.n_timesteps).map(|t| {
        let t_s = (t as f64 - scene.current_timestep() as f64) * scene.dt_s;
        let turned = Vec2::new(8.0 * t_s, 0.3 * t_s * t_s);
        (t <= scene.current_timestep()).then(|| State { position: now.position + turned, ..now })
    });
    scene.tracks[0].trajectory = Trajectory::new(past.collect());
    let lanes = SceneLanes::new(&scene.lanes);
    let driver = Driver::new(&scene, &lanes, 0).unwrap();
    let curvature_1pm = |at_m: f64| {
        let y = |m: f64| driver.positions(0, &[m])[1].y;
        y(at_m + 1.0) - 2.0 * y(at_m) + y(at_m - 1.0)
    };
    let expected_1pm = 0.6 / 64.0;
    assert!((curvature_1pm(1.0) / expected_1pm - 1.0).abs() < 0.5, "{}", curvature_1pm(1.0));
    assert!(curvature_1pm(3.0) > 0.0, "{}", curvature_1pm(3.0));
}

#[test]
fn who_moves_over_one_way_does_not_change_lanes_the_other_way() {
    for (heading_rad, expected) in [(0.06, true), (-0.06, false)] {
        // From the right lane, there is only one on the left.
        let scene = going_on(&[Drive::straight(0.0, 0.6, heading_rad, 10.0)], two_lanes());
        let plans = driven("lane_change", &scene, &[0]);
        assert_eq!(plans.is_empty(), !expected, "{heading_rad}: {} plans", plans.len());
    }
}

#[test]
fn who_brakes_already_does_not_let_go_before_it_brakes_hard() {
    let all = [14.0, 16.0, 18.0, 20.0].map(|x| {
        let mut scene = going_on(&[drive(0.0, 0.0, 14.0), drive(x, 0.0, 11.0), drive(x + 24.0, 0.0, 3.0)], two_lanes());
        accelerating(&mut scene, 0, -2.0);
        driven("hard_brake", &scene, &[0])
    });
    assert!(all.iter().any(|all| !all.is_empty()));
    for states in all.iter().flatten() {
        let mps2 = accelerations_mps2(&states[0], 0.1);
        let hardest = (0..mps2.len()).min_by(|a, b| mps2[*a].total_cmp(&mps2[*b])).unwrap();
        let gentlest_mps2 = mps2[..hardest].iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert!(gentlest_mps2 < -1.5, "{gentlest_mps2} m/s² before it brakes hard");
    }
}

/// Makes an agent arrive at its present place with this acceleration, m/s², along its heading.
fn accelerating(scene: &mut Scene, agent_idx: usize, mps2: f64) {
    let present = scene.current_timestep();
    let now = *scene.state(agent_idx, present).unwrap();
    let forward = Vec2::from_angle(now.heading_rad);
    let past = (0..scene.n_timesteps).map(|t| {
        let t_s = (t as f64 - present as f64) * scene.dt_s;
        let moved = now.velocity * t_s + forward * (mps2 * t_s * t_s / 2.0);
        let state = State { position: now.position + moved, velocity: now.velocity + forward * (mps2 * t_s), ..now };
        (t <= present).then_some(state)
    });
    scene.tracks[agent_idx].trajectory = Trajectory::new(past.collect());
}

/// The accelerations along the motion after each timestep from the present on, m/s².
fn accelerations_mps2(states: &[State], dt_s: f64) -> Vec<f64> {
    states.windows(2).map(|pair| (pair[1].speed_mps() - pair[0].speed_mps()) / dt_s).collect()
}

#[test]
fn who_brakes_before_a_collision_does_not_let_go_of_the_brake() {
    let mut n_templates = 0;
    for meters in 8..20 {
        let crossing = Drive::straight(f64::from(meters), -16.0, std::f64::consts::FRAC_PI_2, 8.0);
        let mut scene = going_on(&[drive(0.0, 0.0, 9.0), crossing], LaneGraph::default());
        accelerating(&mut scene, 0, -2.0);
        for states in driven("collision", &scene, &[0, 1]) {
            let [one, other] = [0, 1].map(|i| states[i].iter().map(|state| scene.tracks[i].footprint(state)).collect());
            let (one, other): (Vec<_>, Vec<_>) = (one, other);
            let met = one.iter().zip(&other).position(|(own, theirs)| own.overlaps(theirs)).unwrap();
            let before = &accelerations_mps2(&states[0], scene.dt_s)[..met];
            assert!(before.iter().all(|mps2| *mps2 < -1.0), "{meters} m: {before:?}");
            n_templates += 1;
        }
    }
    assert!(n_templates > 3, "{n_templates}");
}

#[test]
fn drivers_brake_for_pedestrians_who_turn_to_the_lane_and_these_walk_on_until_then() {
    let (id, mut scene, agents) = possible().into_iter().find(|(id, ..)| *id == "pedestrian_steps_out").unwrap();
    // Along the road, farther from it than at the start.
    let present = scene.current_timestep();
    let walker = *scene.state(1, present).unwrap();
    let walking = (0..scene.n_timesteps).map(|t| {
        let position = walker.position + Vec2::new(1.2 * (t as f64 - present as f64) * scene.dt_s, -1.5);
        (t <= present).then_some(State { position, velocity: Vec2::new(1.2, 0.0), ..walker })
    });
    scene.tracks[1].trajectory = Trajectory::new(walking.collect());
    let templates = driven(id, &scene, &agents);
    assert!(!templates.is_empty());
    for states in templates {
        let turns = states[1].iter().position(|state| state.velocity.y > 0.3).unwrap();
        let slowest = states[1].iter().map(State::speed_mps).fold(f64::INFINITY, f64::min);
        assert!(slowest > 0.5, "the pedestrian stops: {slowest} m/s");
        let own_mps2 = accelerations_mps2(&states[0], scene.dt_s);
        let brakes = own_mps2.iter().position(|mps2| *mps2 < -0.8).unwrap();
        assert!(brakes as f64 * scene.dt_s <= turns as f64 * scene.dt_s + 1.5, "{brakes} after {turns}");
        let gains = own_mps2[turns..].iter().copied().fold(0.0, f64::max);
        assert!(gains < 0.3, "{gains} m/s²");
    }
}

#[test]
fn nobody_drives_through_another_after_a_collision() {
    let (id, scene, agents) = possible().into_iter().find(|(id, ..)| *id == "collision").unwrap();
    for states in driven(id, &scene, &agents) {
        let [one, other] = [&states[0], &states[1]];
        let footprint = |agent: usize, state: &State| scene.tracks[agents[agent]].footprint(state);
        let met = one.iter().zip(other).position(|(a, b)| footprint(0, a).overlaps(&footprint(1, b))).unwrap();
        let apart = |step: usize| one[step].position - other[step].position;
        let moved_m = (met..one.len()).map(|step| apart(step).distance(apart(met))).fold(0.0, f64::max);
        assert!(moved_m < 1.6, "{moved_m} m after they met");
    }
}

#[test]
fn slow_vehicles_do_not_turn_across_the_lanes() {
    for speed_mps in [3.0, 5.0, 7.0, 10.0] {
        let scene = going_on(&[drive(0.0, 0.0, speed_mps)], fork_with_oncoming());
        for states in driven("wrong_way", &scene, &[0]) {
            let turned = states[0].iter().map(|state| state.heading_rad.abs()).fold(0.0, f64::max);
            assert!(turned < 0.4, "{turned} at {speed_mps} m/s");
        }
    }
}

#[test]
fn brakes_are_let_go_of_slowly_and_no_gas_is_given_toward_a_bend() {
    // On a way that turns after some meters; braking at present, asked for gas.
    let braking = |t_s: f64| State {
        position: Vec2::new(-8.0 + 9.0 * t_s - t_s * t_s, 0.0),
        velocity: Vec2::new(9.0 - 2.0 * t_s, 0.0),
        ..State::default()
    };
    let mut scene = going_on(&[drive(-8.0, 0.0, 9.0)], fork());
    let present = scene.current_timestep();
    let past =
        (0..scene.n_timesteps).map(|t| (t <= present).then(|| braking((t as f64 - present as f64) * scene.dt_s)));
    scene.tracks[0].trajectory = Trajectory::new(past.collect());
    let driver = super::Driver::new(&scene, &crate::behavior::lane_relation::SceneLanes::new(&scene.lanes), 0).unwrap();
    assert!((driver.braking_mps2() + 2.0).abs() < 0.1, "{}", driver.braking_mps2());
    let is_turning = |rail: &usize| driver.positions(*rail, &[40.0])[1].y.abs() > 5.0;
    let turning = (0..driver.rails.len()).find(is_turning).unwrap();
    let speeds = driver.travel(turning, &super::Pace::steady(2.0)).speeds_mps;
    let accelerations: Vec<f64> = speeds.windows(2).map(|pair| (pair[1] - pair[0]) / scene.dt_s).collect();
    assert!((accelerations[0] + 2.0).abs() < 0.5, "{accelerations:?}");
    let rises = accelerations.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    assert!(rises <= 2.5 * scene.dt_s + 1e-9, "{rises}");
    assert!(accelerations.iter().all(|mps2| *mps2 < 0.8), "gas before the bend: {accelerations:?}");
}

#[test]
fn braking_builds_up_fades_and_costs_what_it_is_to_cost() {
    for (mps2, loses_mps) in [(1.2, 2.0), (3.0, 4.5), (5.0, 6.0), (7.0, 9.0)] {
        let pace = super::Pace::steady(0.0).losing(0.5, mps2, loses_mps);
        let at: Vec<f64> = (0..10_000).map(|i| pace.at(f64::from(i) * 1e-3)).collect();
        let lost_mps = -at.iter().sum::<f64>() * 1e-3;
        assert!((lost_mps - loses_mps).abs() < 0.05 * loses_mps, "{mps2} m/s²: {lost_mps} m/s");
        let fastest = at.windows(2).map(|pair| (pair[1] - pair[0]).abs() * 1e3).fold(0.0, f64::max);
        assert!(at.iter().all(|a| (-mps2 - 1e-9..=0.0).contains(a)), "{mps2} m/s²");
        assert!(fastest <= if mps2 < 4.0 { 3.01 } else { 10.01 }, "{mps2} m/s²: {fastest} m/s³");
        // To a stand from 10 m/s: firmer at first, and as wanted halfway.
        let pace = super::Pace::steady(0.0).stopping(0.5, mps2, 10.0);
        let at = |elapsed_s: f64| -pace.at(0.5 + elapsed_s);
        let (pressed_s, takes_s) = (1.15 * mps2 / 10.0, 10.0 / mps2);
        assert!((at(pressed_s.max(0.3)) - (1.15 * mps2).min(7.8)).abs() < 0.1 * mps2 && at(takes_s + 1.0) < mps2);
        assert!((at(pressed_s + takes_s / 2.0) - mps2).abs() < 0.05 * mps2, "{mps2} m/s²");
    }
}

#[test]
fn a_leader_brakes_to_a_stand_only_if_there_is_something_to_stop_for() {
    let slowest_mps = |drives: &[Drive], lanes: LaneGraph| {
        let scene = going_on(drives, lanes);
        let states = driven_by("hard_brake", &scene, &[0], &[1]);
        assert!(!states.is_empty());
        states.iter().flat_map(|states| &states[0]).map(State::speed_mps).fold(f64::INFINITY, f64::min)
    };
    let (own, leader) = (drive(0.0, 0.0, 12.0), drive(14.0, 0.0, 11.0));
    assert!(slowest_mps(&[own, leader, drive(30.0, 0.0, 6.0)], two_lanes()) > 3.0);
    assert!(slowest_mps(&[own, drive(20.0, 0.0, 11.0), drive(50.0, 0.0, 0.0)], two_lanes()) < 2.0);
}

#[test]
fn nobody_slows_down_to_change_lanes_where_there_is_a_gap_anyway() {
    let ends_mps = |drives: &[Drive]| {
        let all = driven("lane_change", &going_on(drives, two_lanes()), &[0]);
        assert!(!all.is_empty());
        all.iter().map(|states| states[0][40].speed_mps()).fold(f64::INFINITY, f64::min)
    };
    assert!(ends_mps(&[drive(0.0, 0.0, 10.0)]) > 9.7);
    assert!(ends_mps(&[drive(0.0, 0.0, 10.0), drive(13.5, 3.5, 9.5)]) < 9.5);
}

#[test]
fn variants_are_spread_over_all_and_come_back_after_them() {
    for n in 1..60 {
        let all: BTreeSet<usize> = (0..n).map(|variant| spread(variant, n)).collect();
        assert_eq!(all.len(), n);
        assert_eq!((spread(0, n), spread(n, n)), (0, 0));
    }
    let first: Vec<usize> = (0..4).map(|variant| spread(variant, 40)).collect();
    let nearest = first.iter().flat_map(|a| first.iter().map(|b| a.abs_diff(*b))).filter(|gap| *gap > 0).min();
    assert!(nearest.is_some_and(|gap| gap >= 5), "{first:?}");
    assert_eq!(spread(7, 0), 0);
}
