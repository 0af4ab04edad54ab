//! Drives from a scenario of the fixture corpus: repeatable, forkable, with the event as planned and reactions after.

use super::drivers::{AtConstantVelocity, Careful, Idm, Log, Model};
use super::testing::{model, record, situation};
use super::*;
use crate::generate::Futures;
use crate::scene::{Scene, State, Trajectory};
use candle_core::Device;

fn driven(situation: &Situation, world: World, driver: &mut dyn Driver, config: &RolloutConfig) -> Driven {
    let model = model();
    let futures = Futures::new(&model, world.seed, &Device::Cpu).unwrap();
    roll_out(situation, world, driver, &Others::Sampled(&futures), config, Some(20)).unwrap()
}

const SHORT: RolloutConfig = RolloutConfig { horizon_s: 2.0, replan_s: 0.5 };

#[test]
fn the_same_world_and_actions_give_the_same_bytes_also_from_a_saved_state() {
    let situation = situation(&record());
    let whole = driven(&situation, situation.start(1), &mut Model, &SHORT);
    let found = whole.world.to_json().unwrap();
    assert_eq!(found, driven(&situation, situation.start(1), &mut Model, &SHORT).world.to_json().unwrap());
    assert_ne!(whole.world, driven(&situation, situation.start(2), &mut Model, &SHORT).world);
    // From the state at timestep 24, the first replanning after 20, to the same end; and with braking, to another.
    let saved = whole.saved.unwrap();
    assert_eq!((saved.now(), whole.world.now()), (24, 29));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("state.json");
    fs_err::write(&path, saved.to_json().unwrap()).unwrap();
    let again = driven(&situation, World::read(&path).unwrap(), &mut Model, &SHORT);
    assert_eq!(again.world, whole.world);
    // With two other drivers, one of which brakes, the others answer only at the next replanning.
    let steady = driven(&situation, saved.clone(), &mut AtConstantVelocity, &SHORT).world;
    let braked = driven(&situation, saved, &mut Stops, &SHORT).world;
    let mut others = (0..steady.n_tracks()).filter(|idx| *idx != situation.ego_idx);
    assert!(others.all(|idx| steady.state(idx, 27) == braked.state(idx, 27)) && steady != braked);
}

/// A driver that stops at once.
struct Stops;

impl Driver for Stops {
    fn begin(&mut self, _: &Situation, _: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _: Option<State>) -> Result<State, Failed> {
        let state = world.present(situation.ego_idx).unwrap();
        Ok(State { velocity: crate::geometry::Vec2::ZERO, ..state })
    }
}

#[test]
fn the_event_goes_as_planned_and_then_everybody_drives_on() {
    let record = record();
    let situation = situation(&record);
    let [start, end] = situation.event;
    assert!(situation.planned.len() == 1 && start < end && end < situation.scene.n_timesteps);
    let config = RolloutConfig { horizon_s: 4.0, replan_s: 0.5 };
    let driven = driven(&situation, situation.start(1), &mut Log, &config);
    let (other, world) = (situation.planned[0], &driven.world);
    let at = |timestep: usize| situation.scene.state(other, timestep).copied();
    assert!((0..=end).all(|timestep| world.state(other, timestep) == at(timestep)));
    assert!(driven.event_happens == Some(true));
    let last = situation.scene.current_timestep() + 40;
    assert!(driven.outcome != Outcome::Survived || world.now() == last, "{:?}", driven.why);
    // No jump where the model takes over.
    let steps =
        (end.saturating_sub(1)..world.now()).filter_map(|t| world.state(other, t).zip(world.state(other, t + 1)));
    for (before, after) in steps {
        let missed_m = (after.position - before.position - before.velocity * situation.scene.dt_s).norm();
        assert!(missed_m < 0.3, "{missed_m}");
    }
    // The ego was replayed as long as there was something to replay.
    let logged = situation.scene.n_timesteps - 1;
    let place = |state: Option<State>| state.map(|state| (state.position, state.heading_rad));
    let scenario = situation.scene.state(situation.ego_idx, logged).copied();
    assert_eq!(place(world.state(situation.ego_idx, logged)), place(scenario));
}

#[test]
fn a_plan_that_would_ram_an_ego_that_is_elsewhere_is_given_up() {
    let mut record = record();
    let (ego, other) = (record.subject_idx().unwrap(), situation(&record).planned[0]);
    // The other comes from 25 m behind, 10 m/s faster, through the place where the ego stands in this drive.
    let scene: &mut Scene = &mut record.scenario.scene;
    let at = *scene.state(ego, scene.current_timestep()).unwrap();
    let along = crate::geometry::Vec2::from_angle(at.heading_rad);
    let present = scene.current_timestep();
    let states = (0..scene.n_timesteps).map(|timestep| {
        let t_s = (timestep as f64 - present as f64) * scene.dt_s;
        let position = at.position + along * (20.0 * t_s - 25.0);
        Some(State { position, heading_rad: at.heading_rad, velocity: along * 20.0 })
    });
    scene.tracks[other].trajectory = Trajectory::new(states.collect());
    record.events[0].end_timestep = scene.n_timesteps - 1;
    let situation = situation(&record);
    let driven = driven(&situation, situation.start(1), &mut Stops, &SHORT);
    assert!(driven.gave_up_plan && driven.world.plan_ends < situation.scene.n_timesteps - 1);
    // A collision is kept as planned.
    let mut situation = situation;
    situation.is_collision = true;
    let driven = self::driven(&situation, situation.start(1), &mut Stops, &SHORT);
    let side = driven.contact.map(|contact| contact.side);
    assert_eq!((driven.gave_up_plan, driven.outcome, side), (false, Outcome::Hit, Some(Side::Rear)));
}

#[test]
fn peeking_shows_several_futures_that_know_nothing_of_the_plan_and_changes_nothing() {
    let (situation, model) = (situation(&record()), model());
    let futures = Futures::new(&model, 1, &Device::Cpu).unwrap();
    let world = situation.start(1);
    let found = peek::peek(&situation, &world, &futures, 0..3).unwrap();
    let at = |future: &Scene, idx: usize| future.state(idx, 30).map(|state| state.position).unwrap();
    let planned = situation.planned[0];
    let plan = situation.plan(&world, planned, 30).unwrap().position;
    for idx in [situation.ego_idx, planned] {
        assert!(at(&found[0], idx) != at(&found[1], idx) && at(&found[1], idx) != at(&found[2], idx));
    }
    assert!(found.iter().all(|future| at(future, planned).distance(plan) > 1e-3));
    assert_eq!(found, peek::peek(&situation, &world, &futures, 0..3).unwrap());
    let again = peek::peek(&situation, &world, &futures, 3..6).unwrap();
    assert!(found.iter().all(|future| at(future, planned) != at(&again[0], planned)));
    assert_eq!(world, situation.start(1));
}

#[test]
fn who_has_left_stays_away_though_its_plan_returns() {
    let mut record = record();
    let planned = situation(&record).planned[0];
    let scene = &record.scenario.scene;
    record.events[0].end_timestep = scene.n_timesteps - 1;
    let present = scene.current_timestep();
    // For one timestep the plan lies off the map: within the first plan of everybody, and within the second.
    for leaves in [present + 2, present + 7] {
        let mut record = record.clone();
        let track = &mut record.scenario.scene.tracks[planned];
        let states = track.trajectory.entries().iter().enumerate().map(|(timestep, state)| {
            let aside_m = if timestep == leaves { 500.0 } else { 0.0 };
            state.map(|state| State { position: state.position + crate::geometry::Vec2::new(0.0, aside_m), ..state })
        });
        track.trajectory = Trajectory::new(states.collect());
        let mut situation = situation(&record);
        // Nobody gives the plan up, or solves it again.
        (situation.is_collision, situation.aims) = (true, false);
        let world = driven(&situation, situation.start(1), &mut Log, &SHORT).world;
        let there: Vec<usize> = (0..world.n_timesteps()).filter(|t| world.state(planned, *t).is_some()).collect();
        assert_eq!(there, (0..leaves).collect::<Vec<_>>());
        assert!(world.now() > leaves + 5 && situation.plan(&world, planned, leaves + 1).is_some());
    }
}

/// A driver that brakes fully.
struct Brakes;

impl Driver for Brakes {
    fn begin(&mut self, _: &Situation, _: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _: Option<State>) -> Result<State, Failed> {
        let (state, dt_s) = (world.present(situation.ego_idx).unwrap(), situation.scene.dt_s);
        let along = crate::geometry::Vec2::from_angle(state.heading_rad);
        let velocity = along * (state.speed_mps() - 8.0 * dt_s).max(0.0);
        Ok(State { position: state.position + velocity * dt_s, velocity, ..state })
    }
}

#[test]
fn who_comes_up_from_behind_brakes_for_an_ego_that_stops() {
    let mut record = record();
    let (ego, planned) = (record.subject_idx().unwrap(), situation(&record).planned[0]);
    let scene: &mut Scene = &mut record.scenario.scene;
    let follower = (0..scene.tracks.len()).find(|idx| ![ego, planned].contains(idx)).unwrap();
    // It follows the ego's track 25 m behind and 6 m/s faster, and all other agents are away.
    let at = *scene.state(ego, scene.current_timestep()).unwrap();
    let along = crate::geometry::Vec2::from_angle(at.heading_rad);
    let (present, dt_s) = (scene.current_timestep() as f64, scene.dt_s);
    let states = (0..scene.n_timesteps).map(|timestep| {
        let position = at.position + along * ((timestep as f64 - present) * dt_s * 17.0 - 25.0);
        Some(State { position, heading_rad: at.heading_rad, velocity: along * 17.0 })
    });
    scene.tracks[follower].trajectory = Trajectory::new(states.collect());
    for idx in (0..scene.tracks.len()).filter(|idx| ![ego, follower].contains(idx)) {
        scene.tracks[idx].trajectory = Trajectory::new(vec![None; scene.n_timesteps]);
    }
    let situation = situation(&record);
    let config = RolloutConfig { horizon_s: 4.0, replan_s: 0.5 };
    for seed in 1..4 {
        let driven = driven(&situation, situation.start(seed), &mut Brakes, &config);
        assert!(driven.contact.is_none(), "{seed}: {:?} after {} timesteps", driven.why, driven.world.n_timesteps());
        let position = |timestep: usize| driven.world.state(follower, timestep).unwrap().position;
        let speed = |timestep: usize| position(timestep).distance(position(timestep - 1)) / dt_s;
        for timestep in situation.scene.n_history..driven.world.n_timesteps() {
            let braking_mps2 = (speed(timestep - 1) - speed(timestep)) / dt_s;
            assert!(braking_mps2 < 9.0, "{seed}: {braking_mps2} m/s² at {timestep}");
        }
    }
}

#[test]
fn drivers_keep_to_the_way_and_within_what_vehicles_can() {
    let situation = situation(&record());
    for (name, driver) in [("idm", &mut Idm as &mut dyn Driver), ("careful", &mut Careful::default())] {
        let driven = driven(&situation, situation.start(1), driver, &SHORT);
        assert!(driven.max_braking_mps2 <= 8.0 + 1e-6 && driven.progress_m > 1.0, "{name}: {driven:?}");
        for timestep in situation.scene.n_history..driven.world.n_timesteps() {
            let state = driven.world.state(situation.ego_idx, timestep).unwrap();
            let aside_m = situation.way.route.project(state.position).unwrap().offset_m;
            assert!(aside_m.abs() < 0.2, "{name} is {aside_m} m beside its way at {timestep}");
        }
    }
}

#[test]
fn nonsense_is_refused_and_a_driver_that_fails_is_an_outcome() {
    let (situation, model) = (situation(&record()), model());
    let futures = Futures::new(&model, 1, &Device::Cpu).unwrap();
    for (config, why) in [
        (RolloutConfig { horizon_s: 0.0, ..SHORT }, "expected more than 0"),
        (RolloutConfig { replan_s: 9.0, ..SHORT }, "that the model sees ahead"),
        (RolloutConfig { replan_s: 0.25, ..SHORT }, "expected a multiple of the timestep"),
    ] {
        assert!(config.check(&futures).unwrap_err().to_string().contains(why));
    }
    struct Fails;
    impl Driver for Fails {
        fn begin(&mut self, _: &Situation, _: &World) -> Result<(), Failed> {
            Err(Failed::TimedOut("no answer".to_owned()))
        }
        fn next(&mut self, _: &Situation, _: &World, _: Option<State>) -> Result<State, Failed> {
            Err(Failed::because("asked without a beginning"))
        }
    }
    let driven =
        roll_out(&situation, situation.start(1), &mut Fails, &Others::Sampled(&futures), &SHORT, None).unwrap();
    assert_eq!((driven.outcome, driven.why.as_deref()), (Outcome::TimedOut, Some("no answer")));
    let other = World::new("s", 1, 0, [[None; 3].as_slice()]);
    let refused = roll_out(&situation, other, &mut Fails, &Others::Sampled(&futures), &SHORT, None).unwrap_err();
    assert!(refused.to_string().contains("saved state"), "{refused}");
}

#[test]
fn others_expect_an_ego_that_brakes_to_brake_on_and_any_other_to_go_on() {
    let situation = situation(&record());
    let (ego, dt_s) = (situation.ego_idx, situation.scene.dt_s);
    let speeds =
        |world: &World| -> Vec<f64> { drivers::expected(&situation, world, 30).iter().map(State::speed_mps).collect() };
    let mut world = situation.start(1);
    let steady = world.present(ego).unwrap();
    let push = |world: &mut World, speed_mps: f64| {
        let last = world.present(ego).unwrap();
        let along = crate::geometry::Vec2::from_angle(last.heading_rad);
        let state = State { position: last.position + along * (speed_mps * dt_s), velocity: along * speed_mps, ..last };
        let next = |idx: usize| if idx == ego { Some(state) } else { world.present(idx) };
        let next: Vec<_> = (0..world.n_tracks()).map(next).collect();
        world.push(next);
    };
    (0..3).for_each(|_| push(&mut world, steady.speed_mps() + 1.0));
    assert!(speeds(&world).iter().all(|speed_mps| (speed_mps - steady.speed_mps() - 1.0).abs() < 1e-9));
    // From 2.5 m/s in 0.3 s to 1 m/s: 5 m/s², which take the rest in 0.2 s.
    (0..=3).for_each(|i| push(&mut world, 2.5 - 0.5 * f64::from(i)));
    let found = speeds(&world);
    assert!((found[0] - 0.5).abs() < 1e-9 && found[1..].iter().all(|speed_mps| *speed_mps < 1e-9), "{found:?}");
}

#[test]
fn what_the_ego_of_a_scenario_will_do_is_known_and_passes_smoothly_into_what_it_does_then() {
    let mut record = record();
    let ego = record.subject_idx().unwrap();
    let scene = &mut record.scenario.scene;
    for idx in (0..scene.tracks.len()).filter(|idx| *idx != ego) {
        scene.tracks[idx].trajectory = Trajectory::new(vec![None; scene.n_timesteps]);
    }
    // The ego brakes with 4 m/s² from 15 m/s until a second after the present, where its states end.
    let (present, dt_s) = (scene.current_timestep(), scene.dt_s);
    let at = *scene.state(ego, present).unwrap();
    let along = crate::geometry::Vec2::from_angle(at.heading_rad);
    let states = (0..scene.n_timesteps).map(|timestep| {
        let elapsed_s = (timestep as f64 - present as f64) * dt_s;
        let position = at.position + along * (15.0 * elapsed_s - 2.0 * elapsed_s.powi(2));
        (timestep <= present + 10).then_some(State { position, velocity: along * (15.0 - 4.0 * elapsed_s), ..at })
    });
    scene.tracks[ego].trajectory = Trajectory::new(states.collect());
    let situation = situation(&record);
    let world = situation.start(1);
    let ahead = drivers::ahead(&mut Log, &situation, &world, 20, |_, _| None);
    let positions: Vec<_> = (present - 1..=present).filter_map(|t| world.state(ego, t)).chain(ahead).collect();
    let mps: Vec<f64> = positions.windows(2).map(|pair| pair[1].position.distance(pair[0].position) / dt_s).collect();
    let mps2: Vec<f64> = mps.windows(2).map(|pair| (pair[1] - pair[0]) / dt_s).collect();
    assert!(mps2[1..10].iter().all(|mps2| (mps2 + 4.0).abs() < 1e-6), "{mps2:?}");
    // Alone on the road, it lets go of the brake with 4 m/s³.
    assert!(mps2[10..].windows(2).all(|pair| (0.0..0.401).contains(&(pair[1] - pair[0]))), "{mps2:?}");
    assert!((mps2[10] + 3.6).abs() < 0.01 && mps2[19] > -0.1, "{mps2:?}");
}

#[test]
fn an_ego_that_goes_on_keeps_its_distance_from_who_comes_over() {
    // The ego drives with 12 m/s; the other is 20 m ahead and 3 m aside at present, with 9 m/s.
    let ends_with_mps = |across_mps: f64| {
        let mut record = record();
        let ego = record.subject_idx().unwrap();
        let scene = &mut record.scenario.scene;
        let other = (0..scene.tracks.len()).find(|idx| *idx != ego).unwrap();
        let (present, dt_s, n) = (scene.current_timestep(), scene.dt_s, scene.n_timesteps);
        let at = *scene.state(ego, present).unwrap();
        let along = crate::geometry::Vec2::from_angle(at.heading_rad);
        let state = |idx: usize, timestep: usize| {
            let [from, velocity] = match idx == ego {
                true => [at.position, along * 12.0],
                false => [at.position + along * 20.0 + along.left() * 3.0, along * 9.0 - along.left() * across_mps],
            };
            let elapsed_s = (timestep as f64 - present as f64) * dt_s;
            State { position: from + velocity * elapsed_s, velocity, ..at }
        };
        for idx in 0..scene.tracks.len() {
            let known = |timestep: usize| idx == other || idx == ego && timestep <= present;
            let states = (0..n).map(|timestep| known(timestep).then(|| state(idx, timestep)));
            scene.tracks[idx].trajectory = Trajectory::new(states.collect());
        }
        let situation = situation(&record);
        let then = |idx: usize, timestep: usize| (idx == other).then(|| state(idx, timestep));
        let ahead = drivers::ahead(&mut Log, &situation, &situation.start(1), 8, then);
        ahead[7].speed_mps()
    };
    // After 0.8 s, its flank is still 1.3 m beside the path: nobody is in the way yet.
    let (comes_mps, stays_mps) = (ends_with_mps(1.0), ends_with_mps(0.0));
    assert!(comes_mps < stays_mps - 0.3, "{comes_mps}, {stays_mps}");
}
