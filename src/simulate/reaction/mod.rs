//! Corrects sampled futures before they are driven: agents brake that would drive into another, those that have waited
//! for long go on, pedestrians walk on across the road, and vehicles keep to their lanes and change their acceleration
//! smoothly.
//!
//! The model was trained on ordinary traffic. Behind an ego that stops, most of its futures swerve or drive on through
//! it, and hardly any of them stops. Most corrections keep the path of the future, and change when an agent is where.

mod braking;
mod easing;
mod keeping;
mod moving_off;
mod straying;
mod walking;

pub(super) use braking::brake;
pub(super) use easing::ease;
pub(super) use keeping::hold_places;
pub(super) use moving_off::go_on;
pub(super) use straying::keep_to_lanes;
pub(super) use walking::walk_on;

use crate::geometry::{Vec2, wrap_angle};
use crate::scene::{Scene, State, Trajectory};

/// How long it takes to press a pedal, seconds.
const PEDAL_S: f64 = 0.3;

/// The states of an agent from the present on.
fn future(scene: &Scene, agent_idx: usize) -> Vec<State> {
    (scene.current_timestep()..scene.n_timesteps).map_while(|t| scene.state(agent_idx, t).copied()).collect()
}

/// Sets these states as the future of an agent, from the present on.
fn replace(scene: &mut Scene, agent_idx: usize, states: &[State]) {
    let n_before = scene.n_history - 1;
    let past = scene.tracks[agent_idx].trajectory.entries().iter().take(n_before).copied();
    let mut states: Vec<Option<State>> = past.chain(states.iter().copied().map(Some)).collect();
    states.resize(scene.n_timesteps, None);
    scene.tracks[agent_idx].trajectory = Trajectory::new(states);
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
    use super::*;

    pub(super) const DT_S: f64 = 0.1;

    /// Along x from `x` at a constant speed, for 3 s.
    pub(super) fn steady(x: f64, speed_mps: f64) -> Vec<State> {
        let velocity = Vec2::new(speed_mps, 0.0);
        let state = |i: i32| State {
            position: Vec2::new(x, 0.0) + velocity * (f64::from(i) * DT_S),
            heading_rad: 0.0,
            velocity,
        };
        (0..=30).map(state).collect()
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
}
