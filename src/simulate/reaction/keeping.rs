//! The model draws each plan anew, a little beside the last one and not quite along the lane. Over a loop that adds up.
//! Drivers hold their place in the lane, until they change it.

use super::{future, replace};
use crate::behavior::kept_lane::driven_middles;
use crate::geometry::{Path, Vec2, angle_difference, wrap_angle};
use crate::scene::{Scene, State};
use crate::simulate::situation::Situation;

/// A plan that comes this far from the place in the lane that its vehicle has, meters, changes it, as does one whose
/// vehicle moves aside with this speed already, m/s. With these, as many vehicles move aside as in recordings of
/// SUMO's drivers, who hold the others' place exactly.
const CHANGES_M: f64 = 0.3;
const ASIDE_MPS: f64 = 0.05;
/// Within this time, seconds, a vehicle ceases to move aside, and heads along its way.
const SETTLES_S: f64 = 0.4;
/// Where the lane turns by more than this, radians, the model drives: its middle has corners, and no way does.
const STRAIGHT_RAD: f64 = 0.03;
/// Slower vehicles, m/s, stand if their plan leads no farther than this, meters.
const STANDING_MPS: f64 = 0.1;
const STAYS_M: f64 = 0.3;

/// Lets those of `agents` that are vehicles hold their place in straight lanes in the future of this scene, and where
/// they stand.
pub(in crate::simulate) fn hold_places(situation: &Situation, scene: &mut Scene, agents: &[usize]) {
    // Who has not arrived yet is not in the scene.
    let is_here = |idx: &usize| scene.state(*idx, scene.current_timestep()).is_some();
    let is_vehicle = |idx: &usize| situation.scene.tracks[*idx].class.is_motorized();
    let vehicles: Vec<usize> = agents.iter().copied().filter(|idx| is_here(idx) && is_vehicle(idx)).collect();
    for (agent_idx, middle) in driven_middles(scene, &vehicles) {
        let own = future(scene, agent_idx);
        let Some((now, last)) = own.first().zip(own.last()) else { continue };
        if now.speed_mps() < STANDING_MPS && now.position.distance(last.position) < STAYS_M {
            let stands = State { velocity: Vec2::ZERO, ..*now };
            replace(scene, agent_idx, &vec![stands; own.len()]);
        } else if let Some(held) = middle.and_then(|middle| held(&middle, &own, scene.dt_s)) {
            replace(scene, agent_idx, &held);
        }
    }
}

/// These states as far from the middle of the lane as the first one. `None` where that changes, or the lane bends.
fn held(middle: &Path, own: &[State], dt_s: f64) -> Option<Vec<State>> {
    let now = own.first()?;
    let places: Vec<_> = own.iter().map(|state| middle.project(state.position)).collect::<Option<_>>()?;
    let first = places[0];
    let bends = |heading_rad: f64| angle_difference(heading_rad, first.heading_rad).abs() > STRAIGHT_RAD;
    let aside_mps = Vec2::from_angle(first.heading_rad).cross(now.velocity);
    let changes = |offset_m: f64| (offset_m - first.offset_m).abs() > CHANGES_M;
    if aside_mps.abs() > ASIDE_MPS || places.iter().any(|place| bends(place.heading_rad) || changes(place.offset_m)) {
        return None;
    }
    let slip_rad = angle_difference(now.heading_rad, first.heading_rad);
    let mut held = vec![*now];
    for (i, place) in places.iter().enumerate().skip(1) {
        let fades = (-(i as f64) * dt_s / SETTLES_S).exp();
        let offset_m = first.offset_m + aside_mps * SETTLES_S * (1.0 - fades);
        let position = place.point + Vec2::from_angle(place.heading_rad).left() * offset_m;
        let velocity = (position - held[i - 1].position) * (1.0 / dt_s);
        held.push(State { position, heading_rad: wrap_angle(place.heading_rad + slip_rad * fades), velocity });
    }
    Some(held)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{DT_S, steady};
    use super::*;
    use crate::geometry::Polyline;
    use crate::scene::Trajectory;
    use crate::simulate::testing::{record, situation};

    /// States along x at 10 m/s that move to the left with this speed, and turn as they do.
    fn drifting(aside_mps: f64) -> Vec<State> {
        let drift = |(i, state): (usize, State)| State {
            position: state.position + Vec2::new(0.0, aside_mps * i as f64 * DT_S),
            heading_rad: if i > 0 { aside_mps / 10.0 } else { 0.0 },
            ..state
        };
        steady(0.0, 10.0).into_iter().enumerate().map(drift).collect()
    }

    #[test]
    fn a_vehicle_holds_its_place_in_the_lane_until_it_changes_it() {
        let lane = |points: &[[f64; 2]]| Path::new(Polyline(points.iter().map(|[x, y]| Vec2::new(*x, *y)).collect()));
        let middle = lane(&[[-20.0, -0.7], [80.0, -0.7]]);
        let found = held(&middle, &drifting(0.09), DT_S).unwrap();
        let is_held = |(i, state): (usize, &State)| {
            state.position.distance(Vec2::new(i as f64, 0.0)) < 1e-9 && state.heading_rad.abs() < 1e-9
        };
        assert!(found.len() == 31 && found.iter().enumerate().all(is_held), "{found:?}");
        assert!(held(&middle, &drifting(0.3), DT_S).is_none(), "it comes .9 m to the left");
        assert!(held(&lane(&[[-20.0, -0.7], [20.0, -0.7], [80.0, 5.0]]), &drifting(0.0), DT_S).is_none(), "a bend");
        // It has begun to move aside, or all but ceased to.
        let moves = |mps: f64| {
            let mut own = drifting(0.0);
            own[0] = State { velocity: Vec2::new(10.0, mps), heading_rad: mps / 10.0, ..own[0] };
            held(&middle, &own, DT_S)
        };
        assert!(moves(0.2).is_none());
        let last = moves(0.04).unwrap()[30];
        assert!((last.position.y - 0.04 * SETTLES_S).abs() < 1e-4 && last.heading_rad.abs() < 1e-5, "{last:?}");
    }

    #[test]
    fn who_stands_and_creeps_on_for_a_hand_stays_and_who_has_not_arrived_is_no_matter() {
        let situation = situation(&record());
        let mut scene = situation.scene.clone();
        let (present, n) = (scene.current_timestep(), scene.n_timesteps);
        let at = State { velocity: Vec2::ZERO, ..*scene.state(0, present).unwrap() };
        let creeping = |most_m: f64| {
            let state = |t: usize| {
                let crept_m = most_m * t.saturating_sub(present) as f64 / (n - 1 - present) as f64;
                Some(State { position: at.position + Vec2::from_angle(at.heading_rad) * crept_m, ..at })
            };
            Trajectory::new((0..n).map(state).collect())
        };
        for (most_m, stays) in [(0.2, true), (2.0, false)] {
            scene.tracks[0].trajectory = creeping(most_m);
            let mut held = scene.clone();
            hold_places(&situation, &mut held, &[0, situation.scene.tracks.len() - 1, scene.tracks.len()]);
            let moved_m = held.state(0, n - 1).unwrap().position.distance(at.position);
            assert_eq!(moved_m < 1e-9, stays, "{moved_m}");
        }
    }
}
