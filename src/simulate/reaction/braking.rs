//! An agent that drives its front into another in a sampled future, or passes it much faster without room beside it,
//! brakes on the path of that future: as weakly as suffices and at most fully, and no longer than it must. It answers
//! to motion that was sampled or expected at the last replanning, so it reacts within the time between two of them,
//! about as a human does.

use super::{at_stations, future, replace, stations};
use crate::behavior::RELEASE_JERK_MPS3;
use crate::geometry::{OrientedBox, Vec2, angle_difference};
use crate::metrics::eased_mps2;
use crate::scene::{Scene, State};
use crate::simulate::situation::Situation;

/// Full braking, and the decelerations to be tried, m/s².
const FULL_MPS2: f64 = 8.0;
const BRAKES_MPS2: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 6.0, FULL_MPS2];
/// The pedal is pressed within this time, seconds, but no slower than with this jerk, m/s³, and faster than with the
/// next only to brake fully.
const PRESSED_S: f64 = 0.5;
const LEAST_JERK_MPS3: f64 = 4.0;
const MOST_JERK_MPS3: f64 = 9.5;
/// The jerk of the end of braking, m/s³: from 6 m/s², a brake is eased from 2 m/s on.
const ENDS_MPS3: f64 = 9.0;
/// Braking ends after a multiple of this, seconds; until then, it fades to this share, as that of drivers does who see
/// that it helps, or to the next if it is harder than the last, m/s². Full braking does not.
const BRAKES_S: f64 = 0.5;
const FADES_TO: f64 = 0.5;
const FADES_TO_IF_HARD: f64 = 0.75;
const FADING_MPS2: f64 = 4.0;
/// How often the weakest such deceleration is looked for halfway between one that suffices and one that does not.
/// Harder ones keep their reserve.
const N_HALVINGS: usize = 3;
/// Who follows another, with headings that differ by less than this, radians, must not touch it for this long, seconds,
/// after the end of the future either, at the velocities of then.
const FOLLOWS_RAD: f64 = 0.5;
const LOOKS_ON_S: f64 = 1.5;
/// The acceleration at present is its mean over this many timesteps.
const N_SINCE: usize = 3;
/// The gap to be left between two agents, meters, also beside one that is passed faster than this, m/s: at a closer
/// distance, nobody can know whether there will be room.
const MARGIN_M: f64 = 1.0;
const BESIDE_M: f64 = 0.5;
const MUCH_FASTER_MPS: f64 = 5.0;
/// One agent brakes, then those behind it, and so on.
const N_ROUNDS: usize = 4;

/// A deceleration, m/s², and for how many seconds it is wanted.
#[derive(Debug, Clone, Copy)]
struct Braking {
    mps2: f64,
    lasts_s: f64,
}

/// Makes those of `agents` brake that would drive their front into another in the future of this scene, whose tracks
/// are those of the situation.
pub(in crate::simulate) fn brake(situation: &Situation, scene: &mut Scene, agents: &[usize]) {
    for _ in 0..N_ROUNDS {
        let mut has_changed = false;
        for agent_idx in agents.iter().copied() {
            let own = future(scene, agent_idx);
            if drives_into_another(situation, scene, (agent_idx, &own), 0.0) {
                let braked = avoiding(situation, scene, agent_idx, &own);
                has_changed |= braked != own;
                replace(scene, agent_idx, &braked);
            }
        }
        if !has_changed {
            break;
        }
    }
}

/// The weakest braking on the path of these states after which the agent touches nobody, and the shortest such;
/// otherwise full braking to the end.
fn avoiding(situation: &Situation, scene: &Scene, agent_idx: usize, own: &[State]) -> Vec<State> {
    let dt_s = scene.dt_s;
    let from_mps2 = acceleration_mps2(scene, agent_idx);
    let braked = |mps2: f64, lasts_s: f64| braked(own, from_mps2, Braking { mps2, lasts_s }, dt_s);
    let suffices = |own: &Vec<State>| !drives_into_another(situation, scene, (agent_idx, own), MARGIN_M);
    let horizon_s = own.len() as f64 * dt_s;
    let Some(found) = BRAKES_MPS2.into_iter().position(|mps2| suffices(&braked(mps2, horizon_s))) else {
        return braked(FULL_MPS2, f64::INFINITY);
    };
    let weaker_mps2 = found.checked_sub(1).map_or(0.0, |weaker| BRAKES_MPS2[weaker]);
    let n_halvings = if BRAKES_MPS2[found] > FADING_MPS2 { 0 } else { N_HALVINGS };
    let [_, mps2] = (0..n_halvings).fold([weaker_mps2, BRAKES_MPS2[found]], |[weaker, enough], _| {
        let between = f64::midpoint(weaker, enough);
        if suffices(&braked(between, horizon_s)) { [weaker, between] } else { [between, enough] }
    });
    let n_shorter = (horizon_s / BRAKES_S) as usize;
    let mut shorter = (1..=n_shorter).map(|n| braked(mps2, n as f64 * BRAKES_S));
    shorter.find(suffices).unwrap_or_else(|| braked(mps2, horizon_s))
}

/// The acceleration of an agent at present, m/s².
fn acceleration_mps2(scene: &Scene, agent_idx: usize) -> f64 {
    let present = scene.current_timestep();
    let speed_mps = |timestep: usize| scene.state(agent_idx, timestep).map(State::speed_mps);
    let since = present.checked_sub(N_SINCE).and_then(speed_mps).zip(speed_mps(present));
    since.map_or(0.0, |(then, now)| (now - then) / (N_SINCE as f64 * scene.dt_s))
}

/// Whether an agent with these states from the present on comes to touch another that it does not touch at present,
/// rather ahead than beside, if its front is longer by `margin_m`, and its sides wider where it is much faster.
fn drives_into_another(situation: &Situation, scene: &Scene, own: (usize, &[State]), margin_m: f64) -> bool {
    let (agent_idx, states) = own;
    let Some(last) = states.last() else { return false };
    let (present, n_future) = (scene.current_timestep(), scene.n_timesteps - 1 - scene.current_timestep());
    let later = |state: &State, n: usize| State {
        position: state.position + state.velocity * (n as f64 * scene.dt_s),
        ..*state
    };
    let n_on = (LOOKS_ON_S / scene.dt_s).round() as usize;
    let states: Vec<State> = states.iter().copied().chain((1..=n_on).map(|n| later(last, n))).collect();
    (0..scene.tracks.len()).filter(|other_idx| *other_idx != agent_idx).any(|other_idx| {
        let other = |i: usize| {
            let then = scene.state(other_idx, present + i.min(n_future))?;
            Some(later(then, i.saturating_sub(n_future)))
        };
        let is_touched = |own: &State, other: &State, margin_m: f64, beside_m: f64| {
            let body = situation.body(agent_idx, own);
            let center = body.center + Vec2::from_angle(own.heading_rad) * (margin_m / 2.0);
            let [length_m, width_m] = [body.length_m + margin_m, body.width_m + 2.0 * beside_m];
            OrientedBox { center, length_m, width_m, ..body }.overlaps(&situation.body(other_idx, other))
        };
        let is_ahead = |(i, own): (usize, &State)| {
            let other = &other(i)?;
            if i > n_future && angle_difference(own.heading_rad, other.heading_rad).abs() > FOLLOWS_RAD {
                return None;
            }
            let beside_m = if own.speed_mps() - other.speed_mps() > MUCH_FASTER_MPS { BESIDE_M } else { 0.0 };
            let place = (other.position - own.position).rotated(-own.heading_rad);
            is_touched(own, other, margin_m, beside_m).then_some(place.x > 0.0 && place.y.abs() < place.x)
        };
        let is_apart = states.first().zip(other(0)).is_some_and(|(own, other)| !is_touched(own, &other, 0.0, 0.0));
        is_apart && states.iter().enumerate().skip(1).find_map(is_ahead).unwrap_or(false)
    })
}

/// The path of these states, driven from the first on with a braking that builds up and ends as fast as pedals are
/// pressed, after an acceleration of `from_mps2`, but never ahead of them, and later as they brake. It becomes weaker
/// before a stand.
fn braked(states: &[State], from_mps2: f64, braking: Braking, dt_s: f64) -> Vec<State> {
    let stations = stations(states);
    let (mut speed_mps, mut station_m) = (states.first().map_or(0.0, State::speed_mps), 0.0);
    let mut acceleration_mps2 = from_mps2;
    // Who lost speed early and then only kept it would come up to these states where they brake, and there with a jolt.
    let change_mps2 = |at: usize| match stations.get(at.wrapping_sub(1)..=at + 1) {
        Some(&[before_m, now_m, then_m]) => Some((then_m - 2.0 * now_m + before_m) / dt_s.powi(2)),
        _ => None,
    };
    let later_mps2 = |step: usize| {
        let [before, after] = [change_mps2(step - 1), change_mps2(step)];
        before.zip(after).map_or(before.or(after).unwrap_or_default(), |(a, b)| f64::midpoint(a, b))
    };
    let then = stations.iter().enumerate().skip(1).map(|(step, driven_m)| {
        let elapsed_s = (step as f64 - 0.5) * dt_s;
        let most_mps2 = stopping_mps2(speed_mps, dt_s);
        let fades = 1.0 - (1.0 - fades_to(braking.mps2)) * elapsed_s / braking.lasts_s;
        let wanted_mps2 = if elapsed_s < braking.lasts_s { -(braking.mps2 * fades).min(most_mps2) } else { 0.0 };
        let is_ending = -acceleration_mps2 > most_mps2;
        let most_mps3 = if braking.mps2 < FULL_MPS2 { MOST_JERK_MPS3 } else { f64::INFINITY };
        let pressed_mps3 = braking.mps2.max(-acceleration_mps2) / PRESSED_S;
        let pressed_mps2 = pressed_mps3.clamp(LEAST_JERK_MPS3, most_mps3) * dt_s;
        let eased_mps2 = eased_mps2(wanted_mps2, acceleration_mps2, dt_s);
        let released_mps2 = if is_ending { f64::INFINITY } else { RELEASE_JERK_MPS3 * dt_s };
        acceleration_mps2 = eased_mps2.clamp(acceleration_mps2 - pressed_mps2, acceleration_mps2 + released_mps2);
        acceleration_mps2 = acceleration_mps2.min(later_mps2(step).max(-most_mps2));
        let then_mps = (speed_mps + acceleration_mps2 * dt_s).max(0.0);
        let moved_m = (f64::midpoint(speed_mps, then_mps) * dt_s).min(driven_m - station_m);
        station_m += moved_m;
        let reached_mps = then_mps.min(moved_m / dt_s);
        // Whoever brakes harder by itself already has the pedal there.
        acceleration_mps2 = acceleration_mps2.min((reached_mps - speed_mps) / dt_s).max(-FULL_MPS2);
        speed_mps = reached_mps;
        station_m
    });
    at_stations(states, &stations, then, dt_s)
}

/// The hardest deceleration for the next timestep, m/s², from which a vehicle at this speed still comes to a stand
/// without a jolt: a ≤ √(2 j v) with the jerk j and the speed v at its end.
fn stopping_mps2(speed_mps: f64, dt_s: f64) -> f64 {
    let eases_mps2 = ENDS_MPS3 * dt_s;
    (eases_mps2.powi(2) + 2.0 * ENDS_MPS3 * speed_mps).sqrt() - eases_mps2
}

/// The share to which a deceleration fades, m/s².
fn fades_to(mps2: f64) -> f64 {
    match mps2 {
        FULL_MPS2.. => 1.0,
        mps2 if mps2 > FADING_MPS2 => FADES_TO_IF_HARD,
        _ => FADES_TO,
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{DT_S, steady};
    use super::*;
    use crate::scene::Trajectory;
    use crate::simulate::testing::{record, situation};

    #[test]
    fn braking_builds_up_ends_and_keeps_the_way() {
        let braked = |own: &[State], mps2: f64, lasts_s: f64| super::braked(own, 0.0, Braking { mps2, lasts_s }, DT_S);
        // From 10 m/s at 8 m/s², which the pedal reaches by 12.65 m/s³, in timesteps as if it began 0.27 s later: 4.2
        // m/s after a second. It is let go of from 3.56 m/s on, 8.1 m from the start, and leads 2/3 v²/a = 1.06 m on.
        let found = braked(&steady(0.0, 10.0), 8.0, 3.0);
        assert!((found[10].speed_mps() - 4.6).abs() < 0.15, "{}", found[10].speed_mps());
        assert!((found[30].position.x - 9.15).abs() < 0.1 && found[30].speed_mps() < 1e-9, "{:?}", found[30]);
        let mps2 = |i: usize| (found[i + 1].speed_mps() - found[i].speed_mps()) / DT_S;
        let ends = (10..28).map(|i| mps2(i + 1) - mps2(i)).fold(0.0, f64::max);
        assert!(ends < 10.0 * DT_S, "it stands without a jolt: {ends}");
        // For a second at 4 m/s² that fade to 2: it loses 3 m/s less the 0.8 of the pedal, and 0.4 while it lets go of
        // 2 m/s² by 5 m/s³. Then it drives on.
        let found = braked(&steady(0.0, 10.0), 4.0, 1.0);
        assert!((found[20].speed_mps() - 7.4).abs() < 0.15, "{}", found[20].speed_mps());
        assert!((found[30].speed_mps() - found[20].speed_mps()).abs() < 1e-9);
        let jerk = |states: &[State]| {
            let speed = |i: usize| states[i].speed_mps();
            (2..30).map(|i| (speed(i + 1) - 2.0 * speed(i) + speed(i - 1)).abs() / DT_S.powi(2)).fold(0.0, f64::max)
        };
        assert!(jerk(&found) < 8.01, "{}", jerk(&found));
        // An agent that brakes harder by itself does so.
        let own = braked(&steady(0.0, 10.0), 8.0, 3.0);
        assert!(braked(&own, 2.0, 3.0)[30].position.distance(own[30].position) < 0.2);
        // One that brakes later still does, without coming up to where it would have been.
        let late: Vec<State> = steady(0.0, 10.0)[..=10]
            .iter()
            .copied()
            .chain(own[1..=20].iter().map(|state| State { position: state.position + Vec2::new(10.0, 0.0), ..*state }))
            .collect();
        let found = braked(&late, 2.0, 0.5);
        assert!(found.iter().zip(&late).skip(10).all(|(a, b)| a.position.x < b.position.x));
        let hardest = found[1..].windows(2).map(|pair| (pair[0].speed_mps() - pair[1].speed_mps()) / DT_S);
        assert!(hardest.fold(0.0, f64::max) < 8.01, "without a jolt where it comes up");
        assert!(braked(&steady(3.0, 0.0), 8.0, 3.0).iter().all(|state| state.position == Vec2::new(3.0, 0.0)));
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
        // The second has 20 m to where it would touch the margin, and can stop there comfortably.
        let end_mps = future(&braked, 1).last().unwrap().speed_mps();
        assert!((40.0..=45.0).contains(&last(1)) && last(1) + end_mps.powi(2) / 4.0 < 45.0, "{} {end_mps}", last(1));
        // The third has as far to the second as that comes.
        assert!((20.0..=last(1) - 5.0).contains(&last(2)), "{}", last(2));
        assert_eq!([last(0), last(3)], [50.0, 55.0]);
    }

    /// An agent comes up behind one that is 4 m/s slower, and no longer brakes when it is as slow.
    #[test]
    fn braking_ends_when_nobody_is_driven_into() {
        let mut situation = situation(&record());
        let scene = &mut situation.scene;
        scene.tracks.truncate(2);
        let n_before = scene.n_history - 1;
        for (track, states) in scene.tracks.iter_mut().zip([steady(12.0, 11.0), steady(0.0, 15.0)]) {
            let states = std::iter::repeat_n(None, n_before).chain(states.into_iter().map(Some)).collect();
            track.trajectory = Trajectory::new(states);
            track.extent = Some(crate::scene::Extent { length_m: 4.0, width_m: 2.0 });
        }
        scene.n_timesteps = n_before + 31;
        let mut braked = situation.scene.clone();
        brake(&situation, &mut braked, &[1]);
        let end = *future(&braked, 1).last().unwrap();
        assert!((8.0..=13.0).contains(&end.speed_mps()), "{}", end.speed_mps());
        assert!(end.position.x < 12.0 + 33.0 - 4.0);
    }
}
