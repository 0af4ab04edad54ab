//! Makes agents brake that would drive into another, and agents go on that have waited for long.
//!
//! The model was trained on ordinary traffic. Behind an ego that stops, most of its futures swerve or drive on through
//! it, and hardly any of them stops. So an agent that drives its front into another in a sampled future, or passes it
//! much faster without room beside it, is corrected: it keeps the path of that future and brakes on it, as weakly as
//! suffices and at most fully. It answers to motion that was sampled or expected at the last replanning, so it reacts
//! within the time between two of them, about as a human does.
//!
//! Agents that stand or creep mostly still do so a moment later: with no more than a second of memory, some would wait
//! at a free road forever. So an agent that has hardly moved for some time goes on along its lane as soon as that
//! touches nobody, unless its lane has a light, whose state is unknown.

use super::situation::Situation;
use super::world::World;
use crate::behavior::kept_lane::way_on;
use crate::behavior::may_walk;
use crate::geometry::{OrientedBox, Polyline, Vec2, wrap_angle};
use crate::scene::{Lane, Scene, State, Trajectory};

/// The decelerations to be tried, m/s²; the last is full braking.
const BRAKES_MPS2: [f64; 4] = [2.0, 4.0, 6.0, 8.0];
/// The gap to be left between two agents, meters, also beside one that is passed faster than this, m/s: at a closer
/// distance, nobody can know whether there will be room.
const MARGIN_M: f64 = 1.0;
const BESIDE_M: f64 = 0.5;
const MUCH_FASTER_MPS: f64 = 5.0;
/// An agent that has moved less than this far in this time, meters and seconds, has waited long enough; it accelerates
/// with this, m/s², up to this, m/s.
const WAITED_M: f64 = 2.0;
const WAITED_S: f64 = 8.0;
const STARTS_MPS2: f64 = 1.5;
const STARTS_UP_TO_MPS: f64 = 5.0;
/// A pedestrian of the event who crosses the road at least this fast, m/s, walks on; nobody on foot who walks begins to
/// run, which is faster than this, m/s.
const CROSSES_MPS: f64 = 0.3;
const WALKS_UP_TO_MPS: f64 = 2.2;
/// One agent brakes, then those behind it, and so on.
const N_ROUNDS: usize = 4;
/// How long it takes to press a pedal, seconds.
const PEDAL_S: f64 = 0.3;

/// Makes those of `agents` brake that would drive their front into another in the future of this scene, whose tracks
/// are those of the situation.
pub(super) fn brake(situation: &Situation, scene: &mut Scene, agents: &[usize]) {
    for _ in 0..N_ROUNDS {
        let mut has_changed = false;
        for agent_idx in agents.iter().copied() {
            let own = future(scene, agent_idx);
            if drives_into_another(situation, scene, (agent_idx, &own), 0.0) {
                let braked = BRAKES_MPS2.map(|mps2| braked(&own, mps2, scene.dt_s));
                let suffices = |own: &&Vec<State>| !drives_into_another(situation, scene, (agent_idx, own), MARGIN_M);
                if let Some(chosen) = braked.iter().find(suffices).or_else(|| braked.last()) {
                    has_changed |= *chosen != own;
                    replace(scene, agent_idx, chosen);
                }
            }
        }
        if !has_changed {
            break;
        }
    }
}

/// Makes those of `agents` go on that have waited for long, in the future of this scene.
pub(super) fn go_on(situation: &Situation, world: &World, scene: &mut Scene, agents: &[usize]) {
    let n_waited = (WAITED_S / scene.dt_s).round() as usize;
    let Some(then) = world.now().checked_sub(n_waited) else { return };
    for agent_idx in agents.iter().copied().filter(|idx| situation.scene.tracks[*idx].class.is_motorized()) {
        let waits = |other: State| {
            world.state(agent_idx, then).is_some_and(|state| state.position.distance(other.position) < WAITED_M)
        };
        let own = future(scene, agent_idx);
        let Some((now, last)) = own.first().zip(own.last()).filter(|(now, last)| waits(**now) && waits(**last)) else {
            continue;
        };
        let started = started(scene, agent_idx, now, own.len());
        let comes_farther = |end: &State| end.position.distance(now.position) > last.position.distance(now.position);
        if started.last().is_some_and(comes_farther) && !touches_another(situation, scene, (agent_idx, &started)) {
            replace(scene, agent_idx, &started);
        }
    }
}

/// Makes pedestrians of the event that are on the road walk on across it as they walk, and keeps all of `agents` on
/// foot from running in the future of this scene: the model knows few who cross in front of somebody, and freezes them
/// there.
pub(super) fn walk_on(situation: &Situation, scene: &mut Scene, agents: &[usize]) {
    for agent_idx in agents.iter().copied() {
        let (own, class) = (future(scene, agent_idx), situation.scene.tracks[agent_idx].class);
        let Some(now) = own.first().copied().filter(|now| may_walk(class, now)) else { continue };
        let is_on_road = situation.off_road_m(&now).is_some_and(|off_m| off_m <= 0.0);
        let crosses = is_on_road && now.speed_mps() >= CROSSES_MPS && situation.planned.contains(&agent_idx);
        let most_mps = now.speed_mps().max(WALKS_UP_TO_MPS);
        let walked: Vec<State> = match crosses {
            true => (0..own.len())
                .map(|i| State { position: now.position + now.velocity * (i as f64 * scene.dt_s), ..now })
                .collect(),
            false => held_to(&own, most_mps, scene.dt_s),
        };
        if walked != own {
            replace(scene, agent_idx, &walked);
        }
    }
}

/// The states of an agent that starts along its lane. Empty if it is in no lane, or lights control the lane.
fn started(scene: &Scene, agent_idx: usize, now: &State, n_states: usize) -> Vec<State> {
    let past = Scene { n_timesteps: scene.n_history, ..scene.clone() };
    let ahead = way_on(&past, agent_idx, STARTS_UP_TO_MPS * n_states as f64 * scene.dt_s);
    let is_on =
        |lane: &Lane, at: Vec2| lane.centerline.project(at).is_some_and(|place| place.offset_m.abs() < MARGIN_M);
    let controlled = || scene.lanes.lanes().iter().filter(|lane| has_light(lane));
    if ahead.is_empty() || ahead.iter().any(|at| controlled().any(|lane| is_on(lane, *at))) {
        return Vec::new();
    }
    let way = Polyline(std::iter::once(now.position).chain(ahead).collect());
    let (mut speed_mps, mut station_m, mut states) = (now.speed_mps(), 0.0, vec![*now]);
    while states.len() < n_states {
        speed_mps = (speed_mps + STARTS_MPS2 * scene.dt_s).min(STARTS_UP_TO_MPS);
        station_m += speed_mps * scene.dt_s;
        let Some((position, before)) = way.point_at(station_m).zip(states.last().copied()) else { break };
        let velocity = (position - before.position) * (1.0 / scene.dt_s);
        let heading_rad = if speed_mps > STARTS_MPS2 { velocity.angle() } else { before.heading_rad };
        states.push(State { position, heading_rad, velocity });
    }
    states
}

/// Whether lights control a lane, or may do so: something does, and no rule makes its drivers yield or stop.
fn has_light(lane: &Lane) -> bool {
    lane.attributes.has_traffic_control && lane.attributes.duties().next().is_none()
}

/// Whether an agent with these states from the present on ever comes closer to another than the margin.
fn touches_another(situation: &Situation, scene: &Scene, (agent_idx, states): (usize, &[State])) -> bool {
    let grown = |own: &State| {
        let body = situation.body(agent_idx, own);
        OrientedBox { length_m: body.length_m + 2.0 * MARGIN_M, width_m: body.width_m + MARGIN_M, ..body }
    };
    states.iter().enumerate().skip(1).any(|(i, own)| {
        let (own, timestep) = (grown(own), scene.current_timestep() + i);
        let others = (0..scene.tracks.len()).filter(|idx| *idx != agent_idx);
        others
            .filter_map(|idx| Some((idx, scene.state(idx, timestep)?)))
            .any(|(idx, other)| own.overlaps(&situation.body(idx, other)))
    })
}

/// Sets these states as the future of an agent, from the present on.
fn replace(scene: &mut Scene, agent_idx: usize, states: &[State]) {
    let n_before = scene.n_history - 1;
    let past = scene.tracks[agent_idx].trajectory.entries().iter().take(n_before).copied();
    let mut states: Vec<Option<State>> = past.chain(states.iter().copied().map(Some)).collect();
    states.resize(scene.n_timesteps, None);
    scene.tracks[agent_idx].trajectory = Trajectory::new(states);
}

/// The states of an agent from the present on.
fn future(scene: &Scene, agent_idx: usize) -> Vec<State> {
    (scene.current_timestep()..scene.n_timesteps).map_while(|t| scene.state(agent_idx, t).copied()).collect()
}

/// Whether an agent with these states from the present on comes to touch another that it does not touch at present,
/// rather ahead than beside, if its front is longer by `margin_m`, and its sides wider where it is much faster.
fn drives_into_another(situation: &Situation, scene: &Scene, own: (usize, &[State]), margin_m: f64) -> bool {
    let (agent_idx, states) = own;
    let present = scene.current_timestep();
    (0..scene.tracks.len()).filter(|other_idx| *other_idx != agent_idx).any(|other_idx| {
        let other = |i: usize| scene.state(other_idx, present + i);
        let is_touched = |own: &State, other: &State, margin_m: f64, beside_m: f64| {
            let body = situation.body(agent_idx, own);
            let center = body.center + Vec2::from_angle(own.heading_rad) * (margin_m / 2.0);
            let [length_m, width_m] = [body.length_m + margin_m, body.width_m + 2.0 * beside_m];
            OrientedBox { center, length_m, width_m, ..body }.overlaps(&situation.body(other_idx, other))
        };
        let is_ahead = |(i, own): (usize, &State)| {
            let other = other(i)?;
            let beside_m = if own.speed_mps() - other.speed_mps() > MUCH_FASTER_MPS { BESIDE_M } else { 0.0 };
            let place = (other.position - own.position).rotated(-own.heading_rad);
            is_touched(own, other, margin_m, beside_m).then_some(place.x > 0.0 && place.y.abs() < place.x)
        };
        let is_apart = states.first().zip(other(0)).is_some_and(|(own, other)| !is_touched(own, other, 0.0, 0.0));
        is_apart && states.iter().enumerate().skip(1).find_map(is_ahead).unwrap_or(false)
    })
}

/// The path of these states, driven with this deceleration from the first on, but never ahead of them.
fn braked(states: &[State], deceleration_mps2: f64, dt_s: f64) -> Vec<State> {
    let stations = stations(states);
    let (mut speed_mps, mut station_m) = (states.first().map_or(0.0, State::speed_mps), 0.0);
    let then = stations.iter().skip(1).map(|driven_m| {
        let then_mps = (speed_mps - deceleration_mps2 * dt_s).max(0.0);
        let moved_m = (f64::midpoint(speed_mps, then_mps) * dt_s).min(driven_m - station_m);
        station_m += moved_m;
        speed_mps = then_mps.min(moved_m / dt_s);
        station_m
    });
    at_stations(states, &stations, then, dt_s)
}

/// The path of these states, no faster than `most_mps`.
fn held_to(states: &[State], most_mps: f64, dt_s: f64) -> Vec<State> {
    let stations = stations(states);
    let is_slow = |pair: &[f64]| pair[1] - pair[0] <= most_mps * dt_s + 1e-9;
    if stations.windows(2).all(is_slow) {
        return states.to_vec();
    }
    let mut station_m = 0.0_f64;
    let then = stations.iter().skip(1).map(|driven_m| {
        station_m = (station_m + most_mps * dt_s).min(*driven_m);
        station_m
    });
    at_stations(states, &stations, then, dt_s)
}

/// The path of these states, driven with this much more acceleration, m/s², which builds up as a pedal is pressed;
/// straight on after their end.
pub(super) fn retimed(states: &[State], more_mps2: f64, dt_s: f64) -> Vec<State> {
    let stations = stations(states);
    let (mut more_mps, mut station_m, mut elapsed_s) = (0.0, 0.0, 0.0);
    let then = stations.windows(2).map(|pair| {
        elapsed_s += dt_s;
        more_mps += more_mps2 * (elapsed_s / PEDAL_S).min(1.0) * dt_s;
        let moved_m = (pair[1] - pair[0] + more_mps * dt_s).max(0.0);
        // An agent that the extra braking has stopped has nothing left to lose.
        more_mps = (moved_m - (pair[1] - pair[0])) / dt_s;
        station_m += moved_m;
        station_m
    });
    at_stations(states, &stations, then, dt_s)
}

/// The distance of each of these states along their path, meters.
fn stations(states: &[State]) -> Vec<f64> {
    let mut driven_m = 0.0;
    let steps = states.windows(2).map(|pair| {
        driven_m += pair[1].position.distance(pair[0].position);
        driven_m
    });
    states.iter().take(1).map(|_| 0.0).chain(steps).collect()
}

/// The first of these states, and the states at other stations of their path at the next timesteps.
fn at_stations(states: &[State], stations: &[f64], then: impl Iterator<Item = f64>, dt_s: f64) -> Vec<State> {
    let mut driven: Vec<State> = states.iter().take(1).copied().collect();
    for station_m in then {
        // The first state that is as far, and the one before it.
        let after = stations.partition_point(|driven_m| *driven_m < station_m).min(stations.len() - 1);
        let [from, to] = [after.saturating_sub(1), after];
        let length_m = stations[to] - stations[from];
        let part = if length_m > 0.0 { ((station_m - stations[from]) / length_m).clamp(0.0, 1.0) } else { 1.0 };
        let beyond_m = (station_m - stations[to]).max(0.0);
        let [from, to] = [&states[from], &states[to]];
        let heading_rad = wrap_angle(from.heading_rad + part * wrap_angle(to.heading_rad - from.heading_rad));
        let position = from.position.lerp(to.position, part) + Vec2::from_angle(heading_rad) * beyond_m;
        let velocity = driven.last().map_or(Vec2::ZERO, |last| (position - last.position) * (1.0 / dt_s));
        driven.push(State { position, heading_rad, velocity });
    }
    driven
}

#[cfg(test)]
mod tests {
    use super::super::testing::{record, situation};
    use super::*;

    const DT_S: f64 = 0.1;

    /// Along x from `x` at a constant speed, for 3 s.
    fn steady(x: f64, speed_mps: f64) -> Vec<State> {
        let velocity = Vec2::new(speed_mps, 0.0);
        let state = |i: i32| State {
            position: Vec2::new(x, 0.0) + velocity * (f64::from(i) * DT_S),
            heading_rad: 0.0,
            velocity,
        };
        (0..=30).map(state).collect()
    }

    #[test]
    fn braking_keeps_the_way_and_stands_where_it_must() {
        // From 10 m/s at 4 m/s²: 8 m in the first second, 12.5 m until it stands after 2.5 s.
        let found = braked(&steady(0.0, 10.0), 4.0, DT_S);
        let x = |i: usize| found[i].position.x;
        assert!((x(10) - 8.0).abs() < 1e-9 && (x(25) - 12.5).abs() < 1e-9 && (x(30) - 12.5).abs() < 1e-9);
        assert!((found[10].velocity.x - 6.2).abs() < 1e-9 && found[30].velocity.x.abs() < 1e-9);
        // An agent that brakes harder by itself does so.
        let own = braked(&steady(0.0, 10.0), 8.0, DT_S);
        assert_eq!(braked(&own, 2.0, DT_S).last().map(|state| state.position), own.last().map(|state| state.position));
        assert!(braked(&steady(3.0, 0.0), 8.0, DT_S).iter().all(|state| state.position == Vec2::new(3.0, 0.0)));
    }

    #[test]
    fn a_plan_is_driven_faster_or_slower_on_its_way_and_on_after_its_end() {
        // 2 m/s² more, of which the first 0.3 s bring half: 2.85 s of it after 3 s, which is 8.3 m; the way ends at 30.
        for (more_mps2, speed_mps, end_m) in [(2.0, 15.7, 38.3), (-2.0, 4.3, 21.7), (-8.0, 0.0, 7.0)] {
            let found = retimed(&steady(0.0, 10.0), more_mps2, DT_S);
            let last = found[30];
            let is_near = (last.position.x - end_m).abs() < 1.0 && (last.speed_mps() - speed_mps).abs() < 0.3;
            assert!(is_near && found[0].position.x == 0.0, "{} {}", last.position.x, last.speed_mps());
            assert!(found.windows(2).all(|pair| pair[1].position.x >= pair[0].position.x));
        }
        let same = retimed(&steady(0.0, 10.0), 0.0, DT_S);
        assert!(same.iter().zip(steady(0.0, 10.0)).all(|(a, b)| a.position.distance(b.position) < 1e-9));
    }

    /// Four agents one behind the other on a straight road, the first of which stands: what becomes of the others?
    #[test]
    fn those_behind_brake_as_weakly_as_suffices_and_one_beside_drives_on() {
        let mut situation = situation(&record());
        let scene = &mut situation.scene;
        scene.tracks.truncate(4);
        let n_before = scene.n_history - 1;
        let courses = [steady(50.0, 0.0), steady(25.0, 10.0), steady(8.0, 10.0), steady(25.0, 10.0)];
        for (i, (track, states)) in scene.tracks.iter_mut().zip(courses).enumerate() {
            let beside = Vec2::new(0.0, if i == 3 { 3.5 } else { 0.0 });
            let future = states.into_iter().map(|state| Some(State { position: state.position + beside, ..state }));
            track.trajectory = Trajectory::new(std::iter::repeat_n(None, n_before).chain(future).collect());
            track.extent = Some(crate::scene::Extent { length_m: 4.0, width_m: 2.0 });
        }
        scene.n_timesteps = n_before + 31;
        let mut braked = situation.scene.clone();
        brake(&situation, &mut braked, &[1, 2, 3]);
        let last = |idx: usize| braked.state(idx, braked.n_timesteps - 1).unwrap().position.x;
        // The second has 20 m to where it would touch the margin; 2 m/s² take 21 m within 3 s, 4 m/s² 12.5 m.
        assert!((last(1) - 37.5).abs() < 1e-9, "{}", last(1));
        // The third would come to 38 m, and has to stop before 32.5 m: 2 m/s² take it to 29 m.
        assert!((last(2) - 29.0).abs() < 1e-9, "{}", last(2));
        assert_eq!([last(0), last(3)], [50.0, 55.0]);
    }

    #[test]
    fn who_is_on_the_road_on_foot_walks_on_and_nobody_begins_to_run() {
        let mut situation = situation(&record());
        let (ego, walker) = (situation.ego_idx, situation.planned[0]);
        let at = situation.scene.state(ego, situation.scene.current_timestep()).unwrap().position;
        let present = situation.scene.current_timestep();
        situation.scene.tracks[walker].class = crate::scene::AgentClass::PedestrianOrCyclist;
        let sampled = |speed_mps: f64, then_mps: f64| {
            let mut scene = situation.scene.clone();
            let states = (0..scene.n_timesteps).map(|t| {
                let since_s = (t as f64 - present as f64) * DT_S;
                let mps = if t > present { then_mps } else { speed_mps };
                let (position, velocity) = (at + Vec2::new(mps * since_s, 0.0), Vec2::new(mps, 0.0));
                Some(State { position, heading_rad: 0.0, velocity })
            });
            scene.tracks[walker].trajectory = Trajectory::new(states.collect());
            scene
        };
        let moved_m = |situation: &Situation, speed_mps: f64, then_mps: f64| {
            let mut scene = sampled(speed_mps, then_mps);
            walk_on(situation, &mut scene, &[walker]);
            scene.state(walker, present + 10).unwrap().position.x - at.x
        };
        // Of the event and on the road, it walks on, whatever the model has it do.
        for then_mps in [0.0, 1.4, 3.2] {
            assert!((moved_m(&situation, 1.4, then_mps) - 1.4).abs() < 1e-9);
        }
        // Others do as sampled, but do not run.
        situation.planned.clear();
        let moved = [0.0, 1.4, 3.2].map(|then_mps| moved_m(&situation, 1.4, then_mps));
        assert!(moved.iter().zip([0.0, 1.4, 2.2]).all(|(a, b)| (a - b).abs() < 1e-6), "{moved:?}");
    }

    /// An agent stands in a lane, and another 30 m or 6 m ahead, or the lane has a light: when does it go on?
    #[test]
    fn who_has_waited_goes_on_where_nobody_is_ahead_and_no_light_stands() {
        let mut situation = situation(&record());
        let lane = |has_traffic_control| {
            let center = Polyline(vec![Vec2::new(-20.0, 0.0), Vec2::new(80.0, 0.0)]);
            let lane = Lane::unconnected(1, center, [Polyline::default(), Polyline::default()]);
            let attributes = crate::scene::LaneAttributes { has_traffic_control, ..Default::default() };
            Lane { attributes: std::sync::Arc::new(attributes), ..lane }
        };
        situation.scene.tracks.truncate(2);
        let came_m = |gap_m: f64, waited_s: f64, has_light: bool| {
            let mut situation = situation.clone();
            situation.scene.lanes = std::sync::Arc::new(crate::scene::LaneGraph::new(vec![lane(has_light)]));
            let scene = &mut situation.scene;
            for (track, x) in scene.tracks.iter_mut().zip([0.0, gap_m]) {
                let state = State { position: Vec2::new(x, 0.0), ..State::default() };
                track.trajectory = Trajectory::new(vec![Some(state); scene.n_timesteps]);
                track.extent = Some(crate::scene::Extent { length_m: 4.0, width_m: 2.0 });
            }
            let mut world = situation.start(1);
            for _ in 0..(waited_s / DT_S).round() as usize {
                world.push([world.present(0), world.present(1)]);
            }
            let mut future = situation.scene.clone();
            go_on(&situation, &world, &mut future, &[0]);
            future.state(0, future.n_timesteps - 1).unwrap().position.x
        };
        // 1.5 m/s² over 3 s.
        assert!((came_m(30.0, 8.0, false) - 6.9).abs() < 0.3, "{}", came_m(30.0, 8.0, false));
        assert_eq!([came_m(6.0, 8.0, false), came_m(30.0, 6.0, false), came_m(30.0, 8.0, true)], [0.0; 3]);
    }
}
