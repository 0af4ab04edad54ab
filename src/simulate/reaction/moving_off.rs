//! Agents that stand or creep mostly still do so a moment later: with no more than a second of memory, some would wait
//! at a free road forever. So an agent that has hardly moved for some time goes on along its lane as soon as that
//! touches nobody, unless its lane has a light, whose state is unknown.

use super::{future, replace};
use crate::behavior::way_on::{SETTLES_S, way_on};
use crate::geometry::{OrientedBox, Polyline, Vec2};
use crate::scene::{Lane, Scene, State};
use crate::simulate::situation::Situation;
use crate::simulate::world::World;

/// The gap to be left to others, meters.
const MARGIN_M: f64 = 1.0;
/// An agent that has moved less than this far in this time, meters and seconds, has waited long enough; it accelerates
/// with this, m/s², up to this, m/s.
const WAITED_M: f64 = 2.0;
const WAITED_S: f64 = 8.0;
const STARTS_MPS2: f64 = 1.5;
const STARTS_UP_TO_MPS: f64 = 5.0;

/// Makes those of `agents` go on that have waited for long, in the future of this scene.
pub(in crate::simulate) fn go_on(situation: &Situation, world: &World, scene: &mut Scene, agents: &[usize]) {
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

/// The states of an agent that starts along its lane. Empty if it is in no lane, or lights control the lane.
fn started(scene: &Scene, agent_idx: usize, now: &State, n_states: usize) -> Vec<State> {
    let past = Scene { n_timesteps: scene.n_history, ..scene.clone() };
    let ahead = way_on(&past, agent_idx, STARTS_UP_TO_MPS * n_states as f64 * scene.dt_s, SETTLES_S);
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

#[cfg(test)]
mod tests {
    use super::super::tests::DT_S;
    use super::*;
    use crate::scene::Trajectory;
    use crate::simulate::testing::{record, situation};

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
