//! A sampled future may begin with another acceleration than the one that its vehicle has: after an event that the
//! model would not have driven, more often than not. Nobody lets go of a pedal within a tenth of a second.

use super::{at_stations, future, replace, stations};
use crate::behavior::RELEASE_JERK_MPS3;
use crate::geometry::{angle_difference, wrap_angle};
use crate::scene::{Scene, State};
use crate::simulate::situation::Situation;

/// How fast the acceleration falls where nothing is in the way, m/s³.
const EASED_MPS3: f64 = 3.0;
/// Accelerations are of so many steps before and after the present.
const N_STEPS: usize = 3;
/// A turn goes on as it was, and comes to be that of the future within this time, seconds; the largest difference of
/// yaw rates, and the least that is one, rad/s.
const TURNS_S: f64 = 0.5;
const MOST_RADPS: f64 = 0.15;
const LEAST_RADPS: f64 = 0.01;
/// Slower vehicles do not turn, m/s.
const MOVES_MPS: f64 = 1.0;

/// Lets the acceleration and the turn of those of `agents` that are vehicles pass smoothly into those of the future of
/// this scene: on their path, and a little slower or faster from then on.
pub(in crate::simulate) fn ease(situation: &Situation, scene: &mut Scene, agents: &[usize]) {
    let present = scene.current_timestep();
    for agent_idx in agents.iter().copied().filter(|idx| situation.scene.tracks[*idx].class.is_motorized()) {
        let since = present.saturating_sub(N_STEPS)..=present;
        let past: Vec<State> = since.filter_map(|t| scene.state(agent_idx, t).copied()).collect();
        let own = future(scene, agent_idx);
        if past.len() < N_STEPS + 1 || own.len() <= N_STEPS {
            continue;
        }
        let eased = eased(&past, &own, scene.dt_s);
        let turned = turned(&past, eased.as_deref().unwrap_or(&own), scene.dt_s);
        if let Some(eased) = turned.or(eased) {
            replace(scene, agent_idx, &eased);
        }
    }
}

/// The states from the present on, with headings that begin to change as those of the `past`. `None` if they do, if the
/// yaw rates differ by more than is eased, or if the vehicle hardly moves.
fn turned(past: &[State], own: &[State], dt_s: f64) -> Option<Vec<State>> {
    let [before, now] = [past[N_STEPS - 1], past[N_STEPS]];
    let turns_rad = angle_difference(now.heading_rad, before.heading_rad);
    let more_radps = angle_difference(now.heading_rad + turns_rad, own[1].heading_rad) / dt_s;
    let is_turn = own[1].speed_mps() > MOVES_MPS && (LEAST_RADPS..MOST_RADPS).contains(&more_radps.abs());
    let state = |(i, state): (usize, &State)| {
        // From the first timestep on, the difference of yaw rates fades: ω t exp(-t / τ).
        let (elapsed_s, fades_s) = (i as f64 * dt_s, i as f64 * dt_s - dt_s);
        let beside_rad = more_radps * elapsed_s * (-fades_s / TURNS_S).exp();
        State { heading_rad: wrap_angle(state.heading_rad + beside_rad), ..*state }
    };
    is_turn.then(|| own.iter().enumerate().map(state).collect())
}

/// The states from the present on, with a speed and an acceleration that begin with those of the `past`; the
/// acceleration comes to be theirs. `None` if it does not change faster than drivers let it.
fn eased(past: &[State], own: &[State], dt_s: f64) -> Option<Vec<State>> {
    let step_mps = |states: &[State], i: usize| states[i + 1].position.distance(states[i].position) / dt_s;
    let mps2 = |states: &[State]| (step_mps(states, N_STEPS - 1) - step_mps(states, 0)) / ((N_STEPS - 1) as f64 * dt_s);
    let more_mps2 = mps2(past) - mps2(own);
    let takes_s = more_mps2.abs() / if more_mps2 < 0.0 { RELEASE_JERK_MPS3 } else { EASED_MPS3 };
    if takes_s <= dt_s {
        return None;
    }
    let on_way = stations(own);
    let mut more_mps = step_mps(past, N_STEPS - 1) + mps2(own) * dt_s - step_mps(own, 0);
    let (mut station_m, mut elapsed_s) = (0.0, 0.0);
    let then = on_way.windows(2).map(|pair| {
        more_mps += more_mps2 * (1.0 - elapsed_s / takes_s).max(0.0) * dt_s;
        elapsed_s += dt_s;
        let moved_m = (pair[1] - pair[0] + more_mps * dt_s).max(0.0);
        // Who stands has nothing left to lose.
        more_mps = (moved_m - (pair[1] - pair[0])) / dt_s;
        station_m += moved_m;
        station_m
    });
    Some(at_stations(own, &on_way, then, dt_s))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{DT_S, steady};
    use super::*;
    use crate::geometry::Vec2;

    #[test]
    fn a_turn_passes_smoothly_into_that_of_the_future() {
        // Turning by 0.01 a timestep until the present, and no more from then on.
        let turn = |i: usize, state: &State| State { heading_rad: 0.01 * (i as f64 - N_STEPS as f64), ..*state };
        let past: Vec<State> = steady(-3.0, 10.0)[..=N_STEPS].iter().enumerate().map(|(i, s)| turn(i, s)).collect();
        let own = steady(0.0, 10.0);
        let found = turned(&past, &own, DT_S).unwrap();
        assert!((found[1].heading_rad - 0.01).abs() < 1e-12 && found[0] == own[0]);
        assert!((found[6].heading_rad - 0.06 * (-1.0_f64).exp()).abs() < 1e-12);
        assert!(found.iter().zip(&own).all(|(a, b)| a.position == b.position && a.velocity == b.velocity));
        // It goes on so already, it is a jump that nobody eases, and it crawls.
        let straight = steady(-3.0, 10.0)[..=N_STEPS].to_vec();
        assert_eq!(turned(&straight, &own, DT_S), None);
        let jumped: Vec<State> = past.iter().map(|s| State { heading_rad: s.heading_rad + 0.2, ..*s }).collect();
        assert_eq!(turned(&jumped, &own, DT_S), None);
        assert_eq!(turned(&past, &steady(0.0, 0.5), DT_S), None);
    }

    #[test]
    fn a_pedal_is_let_go_as_drivers_do() {
        // Braking with 6 m/s² until the present, at 10 m/s, from where the future holds its speed.
        let before = |n: usize| State {
            position: Vec2::new(-(10.0 + 0.3 * n as f64) * DT_S * n as f64, 0.0),
            ..steady(0.0, 10.0)[0]
        };
        let past: Vec<State> = (0..=N_STEPS).rev().map(before).collect();
        let found = eased(&past, &steady(0.0, 10.0), DT_S).unwrap();
        // It takes 1.2 s, in which 6 x 1.2 / 2 m/s are lost.
        assert!((found[30].speed_mps() - 6.4).abs() < 0.02, "{}", found[30].speed_mps());
        let all: Vec<Vec2> = past[..N_STEPS].iter().chain(&found).map(|state| state.position).collect();
        let mps: Vec<f64> = all.windows(2).map(|pair| pair[1].distance(pair[0]) / DT_S).collect();
        let mps2: Vec<f64> = mps.windows(2).map(|pair| (pair[1] - pair[0]) / DT_S).collect();
        assert!(mps2.windows(2).all(|pair| (pair[1] - pair[0]).abs() < RELEASE_JERK_MPS3 * DT_S + 0.01), "{mps2:?}");
        assert!((mps2[0] + 6.0).abs() < 0.01 && mps2[20].abs() < 1e-9);
        // Half of a timestep's worth is nothing to ease, and who stands stays.
        assert_eq!(eased(&steady(-3.0 * DT_S * 10.0, 10.0)[..=N_STEPS], &steady(0.0, 10.0), DT_S), None);
        let stands: Vec<State> =
            steady(0.0, 10.0).iter().map(|state| State { position: Vec2::ZERO, ..*state }).collect();
        let stopping = eased(&past, &stands, DT_S).unwrap();
        assert!(stopping.windows(2).all(|pair| pair[1].position.x >= pair[0].position.x));
    }
}
