//! Do arrivals come as often, as fast and where they should, and only where there is room?

use super::super::testing::{record, situation};
use super::*;
use crate::geometry::{Polyline, Transform2};
use crate::scene::{AgentClass, Lane, LaneGraph, LaneId, TrackId};

/// A road of 200 m along x; a side road joins it at 100 m.
fn map() -> LaneGraph {
    let line = |points: &[[f64; 2]]| Polyline(points.iter().map(|[x, y]| Vec2::new(*x, *y)).collect());
    let lane = |id: i64, points: &[[f64; 2]], successors: &[i64], predecessors: &[i64]| {
        let ids = |ids: &[i64]| ids.iter().map(|id| LaneId(*id)).collect();
        let lane = Lane::unconnected(id, line(points), [Polyline::default(), Polyline::default()]);
        Lane { successors: ids(successors), predecessors: ids(predecessors), ..lane }
    };
    LaneGraph::new(vec![
        lane(1, &[[0.0, 0.0], [100.0, 0.0]], &[2], &[]),
        lane(2, &[[100.0, 0.0], [200.0, 0.0]], &[], &[1, 3]),
        lane(3, &[[100.0, -50.0], [100.0, -1.0]], &[2], &[]),
    ])
}

/// A scene with vehicles that drive along x, given by place at present and speed.
fn scene(vehicles: &[[f64; 2]]) -> Scene {
    let mut scene = situation(&record()).scene;
    scene.world_from_scene = Transform2::from_pose(Vec2::new(3.0, 1.0), 0.5);
    let track = scene.tracks[0].clone();
    let scene_from_world = scene.world_from_scene.inverse();
    let vehicle = |[x, mps]: &[f64; 2]| {
        let velocity = Vec2::new(*mps, 0.0);
        let state = |timestep: usize| {
            let after_s = (timestep as f64 - scene.current_timestep() as f64) * scene.dt_s;
            let position = Vec2::new(*x, 0.0) + velocity * after_s;
            // Nobody is seen before 10 m.
            let state = State { position, heading_rad: 0.0, velocity };
            (position.x > 10.0 - 1e-9).then(|| state.transformed(&scene_from_world))
        };
        Track { trajectory: Trajectory::new((0..scene.n_timesteps).map(state).collect()), ..track.clone() }
    };
    scene.tracks = vehicles.iter().map(vehicle).collect();
    scene
}

/// The ends of the road with two scenes: traffic is first seen at 11 m, at 15 m/s.
fn ends() -> Arc<Ends> {
    // Within 30 m: 15 m/s in the first scene, 5 m/s and a standing vehicle in the second; vehicles farther on do not
    // count.
    let scenes = [scene(&[[11.0, 15.0], [60.0, 15.0], [150.0, 9.0]]), scene(&[[39.0, 5.0], [20.0, 0.0]])];
    Arc::new(Ends::of(&map(), &scenes))
}

#[test]
fn arrivals_are_as_many_and_as_fast_as_the_flow_behind_the_end_of_the_map() {
    let (ends, scene) = (ends(), scene(&[[11.0, 15.0]]));
    let wanted_per_s = (15.0 + 5.0) / 30.0 / 2.0;
    assert!((ends.rate_per_s() - wanted_per_s).abs() < 0.02, "{}", ends.rate_per_s());
    let draw = |name: &str, sizes| Arrivals::expect(&ends, &Recorded::default(), (&scene, name, 7), |_| true, sizes);
    let (all, tracks) = draw("a", [20_000, 0]);
    let n_wanted = wanted_per_s * 2000.0;
    assert!((all.n_expected() as f64 - n_wanted).abs() < 4.0 * n_wanted.sqrt(), "{}", all.n_expected());
    let n_fast = all.expected.iter().filter(|arrival| arrival.state.speed_mps() > 10.0).count();
    assert!((n_fast as f64 / all.n_expected() as f64 - 0.75).abs() < 0.07, "{n_fast} of {}", all.n_expected());
    // Longer drives have the same arrivals and some more; other scenarios have others.
    let (few, first) = draw("a", [100, 0]);
    assert!(first.len() < tracks.len() && tracks.starts_with(&first) && all.n_until(110) == few.n_expected());
    let times = |arrivals: &Arrivals| arrivals.expected.iter().take(5).map(|a| a.timestep).collect::<Vec<_>>();
    assert!(times(&all) != times(&draw("b", [20_000, 0]).0) && draw("a", [0, 9]).0.n_expected() == 9);
    assert_eq!(draw("a", [0, 9]).1[..first.len().min(9)], first[..first.len().min(9)]);
    // There are no arrivals where the drive has no map.
    let nowhere = Arrivals::expect(&ends, &Recorded::default(), (&scene, "a", 7), |_| false, [100, 0]);
    assert_eq!(nowhere.0.n_expected(), 0);
}

/// A window of a recording with these agents at its present, each with its name, the frame in which it is first seen
/// and its place and speed along x there; each window has a frame of its own.
fn window(first_frame: i64, tracks: &[(&str, i64, [f64; 3])]) -> Window {
    let mut scene = scene(&[]);
    let vehicle = situation(&record()).scene.tracks[0].clone();
    scene.world_from_scene = Transform2::from_pose(Vec2::new(first_frame as f64, 7.0), 0.1 * first_frame as f64);
    let scene_from_world = scene.world_from_scene.inverse();
    let track = |(id, from, [x, y, mps]): &(&str, i64, [f64; 3])| {
        let state = |timestep: usize| {
            let seen_s = (first_frame + timestep as i64 - from) as f64 * scene.dt_s;
            let (position, velocity) = (Vec2::new(x + mps * seen_s, *y), Vec2::new(*mps, 0.0));
            let state = State { position, heading_rad: 0.0, velocity };
            (seen_s > -1e-9).then(|| state.transformed(&scene_from_world))
        };
        let trajectory = Trajectory::new((0..scene.n_timesteps).map(state).collect());
        let (role, class) = match *id {
            "parked" => (TrackRole::Parked, AgentClass::Vehicle),
            "walks" => (TrackRole::Context, AgentClass::Pedestrian),
            _ => (TrackRole::Context, AgentClass::Vehicle),
        };
        Track { id: TrackId((*id).to_owned()), role, class, trajectory, ..vehicle.clone() }
    };
    scene.tracks = tracks.iter().map(track).collect();
    Window::of(&scene, first_frame)
}

/// The scenario begins in frame 100, so that its present is frame 109, and has the tracks "own" and "other".
fn recorded() -> (Scene, Recorded) {
    let mut scenario = scene(&[[60.0, 10.0], [80.0, 10.0]]);
    for (track, id) in scenario.tracks.iter_mut().zip(["own", "other"]) {
        track.id = TrackId(id.to_owned());
    }
    let windows = [
        // Its past overlaps the scenario's: an agent that came before the scenario's present did not arrive after it.
        window(105, &[("missed", 107, [60.0, 0.0, 10.0]), ("overlapping", 112, [10.0, 0.0, 10.0])]),
        window(
            144,
            &[
                ("own", 144, [90.0, 0.0, 10.0]),
                ("overlapping", 144, [40.0, 0.0, 10.0]),
                ("exact", 150, [10.0, 0.5, 8.0]),
                // Both came at 15 m/s, as others, and braked evenly to 10: 19 m in 1.52 s; 69 m in 5.52 s, but only
                // 2.9 s are left since the present of the window before, in which it came 43.5 m.
                ("on_its_way", 144, [30.0, 0.5, 10.0]),
                ("farther", 144, [80.0, 0.0, 10.0]),
                ("walks", 144, [50.0, 0.0, 1.0]),
                ("aside", 144, [50.0, 30.0, 10.0]),
                ("parked", 144, [50.0, 9.0, 0.0]),
            ],
        ),
        // Too late for agents in its first frame to have come since the window before.
        window(
            300,
            &[("unknown", 300, [30.0, 0.0, 10.0]), ("exact", 300, [90.0, 0.0, 8.0]), ("late", 301, [10.0, 0.0, 9.0])],
        ),
    ];
    let recorded = Recorded::of((&scenario, 100), &windows, &ends());
    (scenario, recorded)
}

#[test]
fn who_came_into_sight_in_other_windows_arrives_then_and_there() {
    let (_, recorded) = recorded();
    let found: Vec<(usize, &str, [f64; 3])> = recorded
        .arrivals()
        .map(|(Arrival { timestep, state, .. }, track)| {
            let rounded =
                [state.position.x, state.position.y, state.velocity.x].map(|value| (value * 1e3).round() / 1e3 + 0.0);
            (*timestep, track.id.0.as_str(), rounded)
        })
        .collect();
    let wanted = [
        (12, "overlapping", [10.0, 0.0, 10.0]),
        (15, "farther", [36.5, 0.0, 15.0]),
        (29, "on_its_way", [11.0, 0.5, 15.0]),
        (44, "walks", [50.0, 0.0, 1.0]),
        (44, "aside", [50.0, 30.0, 10.0]),
        (50, "exact", [10.0, 0.5, 8.0]),
        (201, "late", [10.0, 0.0, 9.0]),
    ];
    assert_eq!(found, wanted);
    // From the present of the scenario to that of the second window, and in the past of the third.
    let covered = [9, 10, 53, 54, 200, 201, 209, 210].map(|timestep| recorded.covers(timestep));
    assert_eq!(covered, [false, true, true, false, false, true, true, false]);
}

#[test]
fn in_times_that_the_recording_covers_nobody_else_arrives_and_longer_drives_have_some_more() {
    let ((scene, recorded), ends) = (recorded(), ends());
    let expect = |sizes| Arrivals::expect(&ends, &recorded, (&scene, "a", 7), |_| true, sizes);
    let (arrivals, tracks) = expect([1000, 0]);
    assert!(arrivals.expected.is_sorted_by_key(|arrival| arrival.timestep));
    let is_right = |(arrival, track): (&Arrival, &Track)| {
        let is_drawn = track.id.0.starts_with("arrival_");
        arrival.is_recorded != is_drawn && recorded.covers(arrival.timestep) != is_drawn
    };
    assert!(arrivals.expected.iter().zip(&tracks).all(is_right));
    let n_recorded = (0..tracks.len()).filter(|number| arrivals.is_recorded(*number)).count();
    assert!(n_recorded == 7 && tracks.len() > 20, "{n_recorded} of {}", tracks.len());
    let alone = Arrivals::expect(&ends, &Recorded::default(), (&scene, "a", 7), |_| true, [1000, 0]);
    // Drawn arrivals are those without a recording.
    let drawn =
        |tracks: &[Track]| tracks.iter().filter(|t| t.id.0.starts_with("arrival_")).cloned().collect::<Vec<_>>();
    let kept = drawn(&tracks);
    assert!(kept.iter().all(|track| alone.1.contains(track)) && kept.len() < alone.1.len());
    // A scene of an earlier loop holds arrivals already.
    let mut continues = scene.clone();
    continues.tracks.push(Track { id: TrackId("arrival_41".to_owned()), ..tracks[0].clone() });
    let later = Arrivals::expect(&ends, &Recorded::default(), (&continues, "a", 7), |_| true, [1000, 0]).1;
    assert_eq!((later.len(), later[0].id.0.as_str()), (alone.1.len(), "arrival_42"));
    // So does a window after it.
    let mut follows = recorded.clone();
    follows.arrivals[0].1.id = TrackId("arrival_9".to_owned());
    let (_, named) = Arrivals::expect(&ends, &follows, (&scene, "a", 7), |_| true, [1000, 0]);
    let n_names = named.iter().map(|track| &track.id).collect::<std::collections::BTreeSet<_>>().len();
    assert_eq!(n_names, named.len());
    for sizes in [[40, 0], [195, 0], [0, 9]] {
        let (fewer, first) = expect(sizes);
        assert!(!first.is_empty() && first.len() < tracks.len() && tracks.starts_with(&first), "{sizes:?}");
        assert_eq!(fewer.n_expected(), if sizes[1] > 0 { 9 } else { arrivals.n_until(10 + sizes[0]) });
    }
}

/// The situation of a scenario on the road of the tests.
fn on_the_road(mut scene: Scene) -> Situation {
    scene.tracks.truncate(1);
    let mut record = record();
    // Arrivals are drawn by the name.
    record.scenario.id = "on the road".to_owned();
    record.scenario.scene = Scene { ego_idx: 0, ..scene };
    Situation::new(&record, 0, Some(&map())).unwrap()
}

/// The agents other than the first, which stands at `x` or drives there, after `n_steps` timesteps.
fn who_enters(situation: &Situation, x: f64, speed_mps: f64, n_steps: usize) -> Vec<(usize, State)> {
    let scene_from_world = situation.scene.world_from_scene.inverse();
    let state = State { position: Vec2::new(x, 0.0), velocity: Vec2::new(speed_mps, 0.0), ..State::default() };
    let mut world = situation.start(1);
    for _ in 0..n_steps {
        world.push((0..world.n_tracks()).map(|idx| (idx == 0).then(|| state.transformed(&scene_from_world))));
    }
    situation.arrivals.enter(situation, &mut world);
    (1..world.n_tracks()).filter_map(|idx| Some((idx, world.present(idx)?))).collect()
}

#[test]
fn who_finds_no_gap_waits_and_then_does_not_come() {
    let scene = scene(&[[30.0, 10.0], [11.0, 10.0]]);
    let ends = Arc::new(Ends::of(&map(), std::slice::from_ref(&scene)));
    let mut situation = on_the_road(scene);
    situation.expect(&ends, &Recorded::default(), 1, [50, 0]);
    let n_expected = situation.arrivals.n_expected();
    assert!(n_expected > 5, "{n_expected}");
    // A vehicle stands 5 m behind the beginning until it goes on.
    let entered = |x: f64, n_steps: usize| -> Vec<usize> {
        who_enters(&situation, x, 0.0, n_steps).into_iter().map(|(idx, _)| idx).collect()
    };
    let first = situation.arrivals.expected[0].timestep - situation.scene.current_timestep();
    assert_eq!((entered(15.0, first), entered(90.0, first), entered(90.0, first - 1)), (vec![], vec![1], vec![]));
    // One at a time, and none more than 5 s late.
    let found = entered(90.0, first + 51);
    assert!(found.len() == 1 && found[0] > 1, "{found:?}");
}

#[test]
fn who_was_recorded_enters_as_it_was_where_neither_it_nor_another_has_to_brake_for_that() {
    let (scenario, recorded) = recorded();
    let mut situation = on_the_road(scenario);
    situation.expect(&ends(), &recorded, 1, [20, 0]);
    let names: Vec<&str> = situation.scene.tracks[1..].iter().map(|track| track.id.0.as_str()).collect();
    assert_eq!(names, ["overlapping", "farther", "on_its_way"]);
    let enters = |x: f64, speed_mps: f64, n_steps: usize| -> Vec<usize> {
        who_enters(&situation, x, speed_mps, n_steps).into_iter().map(|(idx, _)| idx).collect()
    };
    // "overlapping" comes in timestep 12 at 10 m, "farther" in 15 at 37 m: 3 and 6 after the present.
    assert_eq!([enters(150.0, 0.0, 2), enters(150.0, 0.0, 3), enters(150.0, 0.0, 6)], [vec![], vec![1], vec![1, 2]]);
    let (_, state) = who_enters(&situation, 150.0, 0.0, 3)[0];
    let state = state.transformed(&situation.scene.world_from_scene);
    let is_as_recorded = state.position.distance(Vec2::new(10.0, 0.0)) < 1e-9 && (state.velocity.x - 10.0).abs() < 1e-9;
    assert!(is_as_recorded, "{state:?}");
    // An arrival at 15 m/s from 13 m behind the second vehicle would have to brake; a standing one would not.
    assert_eq!([enters(19.0, 15.0, 6), enters(19.0, 0.0, 6)], [vec![], vec![2]]);
}

#[test]
fn who_goes_on_to_where_traffic_is_not_seen_any_more_leaves() {
    // Of 200 m of road 160 are in sight, and their last 30 m hold ten vehicles, or nine.
    let vehicles: Vec<[f64; 2]> = (0..10).map(|i| [160.0 - 3.1 * f64::from(i), 10.0]).collect();
    let ends_with = |n: usize| Arc::new(Ends::of(&map(), &[scene(&vehicles[..n])]));
    let state = |x: f64, heading_rad: f64| State { position: Vec2::new(x, 0.5), heading_rad, velocity: Vec2::ZERO };
    let is_out = |n: usize, x: f64, heading_rad: f64| ends_with(n).is_out_of_sight(&state(x, heading_rad));
    // Ten within 30 m are 3 m apart.
    assert_eq!([162.9, 163.1, 199.0].map(|x| is_out(10, x, 0.0)), [false, true, true]);
    assert_eq!([is_out(10, 20.0, 0.0), is_out(10, 180.0, 3.0), is_out(9, 199.0, 0.0)], [false; 3]);
    // A lane that ends beside one that goes on is left for that one.
    let mut lanes = map().lanes().to_vec();
    lanes[1].left_neighbor = Some(lanes[0].id);
    assert!(!Ends::of(&LaneGraph::new(lanes), &[scene(&vehicles)]).is_out_of_sight(&state(199.0, 0.0)));

    let mut situation = on_the_road(scene(&[[120.0, 10.0]]));
    situation.roles.clear();
    situation.expect(&ends_with(10), &Recorded::default(), 1, [0, 0]);
    let scene_from_world = situation.scene.world_from_scene.inverse();
    let goes = |situation: &Situation, xs: &[f64]| {
        let mut world = situation.start(1);
        xs.iter().for_each(|x| world.push([Some(state(*x, 0.0).transformed(&scene_from_world))]));
        situation.goes_out_of_sight(&world, 0, world.now() - 1)
    };
    // Agents that were there already may stay for good, and an event is not left.
    let found = [&[162.0, 162.9], &[162.0, 163.1], &[163.1, 164.0]].map(|xs| goes(&situation, xs));
    assert_eq!(found, [false, true, false]);
    situation.roles = vec![0];
    assert!(!goes(&situation, &[162.0, 163.1]));
    // The scenario and its event last for 30 timesteps.
    let driven: Vec<f64> = (0..31).map(|i| 160.0 + 0.2 * f64::from(i)).collect();
    assert_eq!([30, 31].map(|n| goes(&situation, &driven[..n])), [false, true]);
}
