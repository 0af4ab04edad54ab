//! Finishes the states of a sample beyond the network's output: standing, velocities, and headings that fit them.

use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{STANDING_STEP_M, State, motion_heading, velocity_at};
use std::f64::consts::FRAC_PI_2;

/// A step shorter than this is no motion, meters: 0.04 m/s at 10 Hz.
const STILL_STEP_M: f64 = 0.004;
/// An agent that was observed to stand for this many states, and is generated to move no farther than this, meters,
/// stays, and so does one that moves no farther than the second length without ever starting: networks let standing
/// vehicles creep. Who starts reaches a speed v, after this distance d or more, with v² / 2d of at least this, m/s². Of
/// those that moved 0.15 to 1 m in 3 s from a stand, 9 of 11 simulated vehicles did so, and 12 of 32 generated ones.
const STANDING_STATES: usize = 6;
const CREEP_M: f64 = 0.15;
const START_WITHIN_M: f64 = 1.0;
const STARTS_MPS2: f64 = 0.4;
/// Speeds of a start are means over this many steps.
const START_STEPS: usize = 3;
/// An agent that moved no faster than this, m/s, in the last observed second is standing, apart from errors of the
/// tracker.
const STANDING_MPS: f64 = 0.2;
/// The generated motion of a standing agent counts in full if it is longer than this, meters, and for little if it is
/// shorter: standing agents of Argoverse 1 moved half a meter in 3 s in the median of samples, 0.12 m in recordings.
const START_M: f64 = 1.0;
/// Velocity is removed within this time, seconds.
const ONSET_S: f64 = 0.3;
/// The end of an agent's motion is the mean of this many states.
const END_STATES: usize = 3;
/// Positions this close are equal up to rounding, meters.
const SAME_PLACE_M: f64 = 1e-6;

/// Whether standing agents are exactly still in a recording; `agents` has the observed states of each agent: steps too
/// short to be motion are mostly zero. Some trackers move standing vehicles by millimeters.
pub(super) fn stands_still<'a>(agents: impl IntoIterator<Item = &'a Vec<Option<State>>>) -> bool {
    let (mut n_still, mut n_moved) = (0, 0);
    for states in agents {
        for pair in states.windows(2) {
            let (Some(before), Some(after)) = (pair[0], pair[1]) else { continue };
            match before.position.distance(after.position) {
                step_m if step_m < SAME_PLACE_M => n_still += 1,
                step_m if step_m < STILL_STEP_M => n_moved += 1,
                _ => (),
            }
        }
    }
    n_still >= n_moved
}

/// Keeps agents that were observed to stand, but not exactly still, in their place, without removing the tracker's
/// errors from their states: the generated displacement w, and the turn, become w · |w|³ / (|w|³ + START_M³).
pub(super) fn stay(entries: &mut [Option<State>], latent: &[u8], dt_s: f64) {
    let Some(last_idx) = (0..entries.len()).rfind(|t| latent[*t] == 0 && entries[*t].is_some()) else { return };
    let (observed, generated) = entries.split_at_mut(last_idx + 1);
    let n_second = (1.0 / dt_s).round() as usize + 1;
    let seen: Vec<State> = observed.iter().rev().map_while(|state| *state).take(n_second).collect();
    let ends: Vec<State> = generated.iter().rev().flatten().take(END_STATES).copied().collect();
    let ([last, ..], [end, ..]) = (seen.as_slice(), ends.as_slice()) else { return };
    let moved_m = seen.iter().map(|state| state.position.distance(last.position)).fold(0.0, f64::max);
    let stands = (SAME_PLACE_M..STANDING_MPS * dt_s * (seen.len() - 1) as f64).contains(&moved_m);
    if seen.len() < STANDING_STATES || !stands {
        return;
    }
    let sum = ends.iter().fold(Vec2::ZERO, |sum, state| sum + (state.position - last.position));
    let way = sum * (1.0 / ends.len() as f64);
    let turn_rad = angle_difference(end.heading_rad, last.heading_rad);
    let taken = START_M.powi(3) / (way.norm().powi(3) + START_M.powi(3));
    // Along the way at a constant speed, except during its onset.
    let ramp = |s: f64| s - ONSET_S * (1.0 - (-s / ONSET_S).exp());
    let n_generated = generated.len();
    for (i, state) in generated.iter_mut().enumerate() {
        let Some(state) = state else { continue };
        let share = taken * ramp((i + 1) as f64 * dt_s) / ramp(n_generated as f64 * dt_s);
        state.position = state.position - way * share;
        state.heading_rad = wrap_angle(state.heading_rad - turn_rad * share);
    }
}

/// Removes steps of a sample that are too short to be motion, after the last observed state, and creeping of agents
/// that stood there: a standing agent is exactly still. Later states are shifted by the sum of the removed steps.
pub(super) fn hold_still(entries: &mut [Option<State>], latent: &[u8], dt_s: f64) {
    let n_entries = entries.len();
    let mut left_out = Vec2::ZERO;
    let first = (0..n_entries).rfind(|t| latent[*t] == 0 && entries[*t].is_some()).map_or(n_entries, |last| last + 1);
    let (observed, generated) = entries.split_at_mut(first);
    let stood = observed.iter().rev().map_while(|state| *state).take(STANDING_STATES).collect::<Vec<_>>();
    if let [last, .., _] = stood[..]
        && stood.len() == STANDING_STATES
        && stood.iter().all(|state| state.position.distance(last.position) < SAME_PLACE_M)
        && creeps(&last, generated, dt_s)
    {
        for state in generated.iter_mut().flatten() {
            *state = State { position: last.position, heading_rad: last.heading_rad, ..*state };
        }
        return;
    }
    for timestep in first..n_entries {
        let (before, Some(state)) = (entries[timestep - 1], entries[timestep]) else { continue };
        let mut held = State { position: state.position - left_out, ..state };
        if let Some(before) = before.filter(|before| held.position.distance(before.position) < STILL_STEP_M) {
            left_out = left_out + (held.position - before.position);
            held = State { position: before.position, heading_rad: before.heading_rad, ..held };
        }
        entries[timestep] = Some(held);
    }
}

/// Whether an agent that stood in this state hardly moves, or moves a little without ever starting.
fn creeps(stood: &State, generated: &[Option<State>], dt_s: f64) -> bool {
    let moved_m = |state: &State| state.position.distance(stood.position);
    let farthest_m = generated.iter().flatten().map(moved_m).fold(0.0, f64::max);
    let starts = |window: &[Option<State>]| {
        let (Some(Some(first)), Some(Some(last))) = (window.first(), window.last()) else { return true };
        let mps = first.position.distance(last.position) / (START_STEPS as f64 * dt_s);
        let middle_m = f64::midpoint(moved_m(first), moved_m(last));
        moved_m(last) >= CREEP_M && mps.powi(2) >= 2.0 * STARTS_MPS2 * middle_m
    };
    farthest_m <= CREEP_M || (farthest_m <= START_WITHIN_M && !generated.windows(START_STEPS + 1).any(starts))
}

/// The source of an agent's headings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HeadingSource {
    /// The network.
    Generated,
    /// The velocity, as for pedestrians.
    Velocity,
    /// The motion, as in datasets without headings ([`motion_heading`]).
    Motion,
}

/// Velocities of generated entries ([`velocity_at`]; 0 for one that stands alone) and headings that are not generated.
pub(super) fn derive_motion(entries: &mut [Option<State>], latent: &[u8], dt_s: f64, headings: HeadingSource) {
    for timestep in 0..entries.len() {
        if latent[timestep] == 0 {
            continue;
        }
        let position = |offset: isize| {
            let entry = timestep.checked_add_signed(offset).and_then(|t| entries.get(t));
            entry.copied().flatten().map(|state: State| state.position)
        };
        let velocity = velocity_at(position, dt_s).unwrap_or_default();
        let before = timestep.checked_sub(1).and_then(|t| entries[t]);
        let Some(state) = entries[timestep].as_mut() else { continue };
        state.velocity = velocity;
        let position = state.position;
        let told = match headings {
            HeadingSource::Generated => continue,
            HeadingSource::Velocity => (velocity.norm() * dt_s > STANDING_STEP_M).then(|| velocity.angle()),
            HeadingSource::Motion => {
                let before = entries[..timestep].iter().rev().flatten();
                motion_heading(position, velocity, before.map(|before| before.position))
            }
        };
        if let Some(state) = &mut entries[timestep] {
            state.heading_rad = told.or(before.map(|before| before.heading_rad)).unwrap_or(state.heading_rad);
        }
    }
}

/// Keeps vehicles from sliding: turns generated headings into the motion by the part of their angle to it that exceeds
/// both what turning explains and the angle in the vehicle's observed states. At a yaw rate ω and a speed v, the center
/// of a vehicle of length L moves at up to atan(L ω / 2 v) to its heading. Vehicles slower than 2 m/s are turned by
/// less, below 1 m/s not at all: maneuvering ones may go backward.
pub(super) fn turn_into_motion(entries: &mut [Option<State>], latent: &[u8], dt_s: f64, length_m: f64) {
    let slides = |entries: &[Option<State>]| -> Vec<f64> {
        (0..entries.len()).map(|t| slide_rad(entries, t, dt_s, length_m)).collect()
    };
    let is_given = |t: &usize| latent[*t] == 0;
    let given_rad =
        slides(entries).iter().enumerate().filter(|(t, _)| is_given(t)).fold(0.0, |a: f64, (_, b)| a.max(b.abs()));
    for _ in 0..N_TURNS {
        let slides = slides(entries);
        let beyond = |t: usize| match is_given(&t) {
            true => 0.0,
            false => slides[t].signum() * (slides[t].abs() - given_rad).max(0.0),
        };
        for (t, entry) in entries.iter_mut().enumerate().filter(|(t, _)| !is_given(t)) {
            let Some(state) = entry else { continue };
            let at = |offset: usize| (t + offset).saturating_sub(2).min(slides.len() - 1);
            let around = WEIGHTS.iter().enumerate().map(|(offset, weight)| weight * beyond(at(offset)));
            state.heading_rad = wrap_angle(state.heading_rad + around.sum::<f64>());
        }
    }
}

/// The number of repetitions: a turn changes the yaw rate, and so the angle that turning explains.
const N_TURNS: usize = 3;
/// Turns are averages over two timesteps before, the same one and two after, so that a vehicle that begins to slide is
/// not turned abruptly.
const WEIGHTS: [f64; 5] = [1.0 / 9.0, 2.0 / 9.0, 3.0 / 9.0, 2.0 / 9.0, 1.0 / 9.0];

/// The angle from heading to motion at timestep `t` beyond what turning explains, radians; 0 if unknown.
fn slide_rad(entries: &[Option<State>], t: usize, dt_s: f64, length_m: f64) -> f64 {
    let (Some(state), Some(before)) = (entries[t], t.checked_sub(1).and_then(|t| entries[t])) else { return 0.0 };
    let speed_mps = state.speed_mps();
    let slip_rad = angle_difference(state.velocity.angle(), state.heading_rad);
    let (after, n_steps) = entries.get(t + 1).copied().flatten().map_or((state, 1.0), |after| (after, 2.0));
    let yaw_rate_radps = angle_difference(after.heading_rad, before.heading_rad) / (n_steps * dt_s);
    let turning_rad = (length_m / 2.0 * yaw_rate_radps / speed_mps.max(1.0)).atan().abs();
    match slip_rad.abs() < FRAC_PI_2 {
        true => slip_rad.signum() * (slip_rad.abs() - turning_rad).max(0.0) * (speed_mps - 1.0).clamp(0.0, 1.0),
        false => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::scene::testing::{Drive, scene};
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, StateParametrization};

    #[test]
    fn who_stands_is_exactly_still_and_who_starts_loses_millimeters() {
        // Half a millimeter of noise about x = 2, then a start at 2 m/s².
        let noise = |t: usize| if t.is_multiple_of(2) { 0.0005 } else { -0.0005 };
        let at = |t: usize| 2.0 + noise(t) + 0.01 * (t.saturating_sub(6) as f64).powi(2);
        let state =
            |t: usize| Some(State { position: Vec2::new(at(t), 0.0), heading_rad: noise(t), ..State::default() });
        let mut entries: Vec<Option<State>> = (0..12).map(state).collect();
        let mut latent = [1; 12];
        latent[..2].fill(0);
        hold_still(&mut entries, &latent, 0.1);
        assert_eq!(entries[0], state(0));
        for entry in &entries[2..7] {
            assert_eq!(*entry, state(1), "as it was last observed");
        }
        for (t, entry) in entries.iter().enumerate().skip(7) {
            let shift_m = entry.unwrap().position.x - at(t);
            assert!(shift_m.abs() < 0.004, "{t}: {shift_m}");
        }
        // Up to an observed state nothing is shifted, so that the state is met.
        let mut entries: Vec<Option<State>> = (0..12).map(state).collect();
        latent[11] = 0;
        hold_still(&mut entries, &latent, 0.1);
        assert_eq!(entries, (0..12).map(state).collect::<Vec<_>>());
        // Without anything observed, too.
        hold_still(&mut entries, &[1; 12], 0.1);
        assert_eq!(entries, (0..12).map(state).collect::<Vec<_>>());
    }

    #[test]
    fn who_stood_and_creeps_stays_and_who_starts_does_not() {
        let latent: Vec<u8> = (0..20).map(|t| u8::from(t >= 6)).collect();
        let held = |moved_m: &dyn Fn(usize) -> f64| {
            let state = |t: usize| State { position: Vec2::new(moved_m(t), 0.0), ..State::default() };
            let mut entries: Vec<Option<State>> = (0..20).map(|t| Some(state(t))).collect();
            hold_still(&mut entries, &latent, 0.1);
            entries[19].unwrap().position.x
        };
        let creeping = |t: usize| 0.01 * t.saturating_sub(5) as f64;
        assert_eq!([held(&creeping), held(&|t| 2.5 * creeping(t))], [0.0; 2]);
        let start = |mps2: f64, t: usize| mps2 / 2.0 * (0.1 * t.saturating_sub(5) as f64).powi(2);
        assert!((held(&|t| start(0.5, t)) - 0.49).abs() < 0.01, "a start");
        assert!((held(&|t| start(0.8, t.min(14))) - 0.324).abs() < 0.01, "a start, and a stop");
        assert_eq!(held(&|t| start(0.3, t)), 0.0, "too slow for a start");
        assert!((held(&|t| 7.5 * creeping(t)) - 1.05).abs() < 1e-9, "too far for a creep");
        assert!((held(&|t| creeping(t) + 0.01 * t.min(5) as f64) - 0.19).abs() < 1e-9, "it rolled before");
    }

    #[test]
    fn who_stood_but_for_the_tracker_stays_with_its_texture_and_who_starts_goes() {
        let latent: Vec<u8> = (0..40).map(|t| u8::from(t >= 10)).collect();
        let jitter = |t: usize| if t.is_multiple_of(2) { 0.01 } else { -0.01 };
        let stayed = |past_mps: f64, mps: f64| -> Vec<State> {
            let state = |t: usize| {
                let after_s = 0.1 * (t as f64 - 9.0);
                let x = after_s * if after_s > 0.0 { mps } else { past_mps };
                State { position: Vec2::new(x, jitter(t)), heading_rad: 0.1 * x, ..State::default() }
            };
            let mut entries: Vec<Option<State>> = (0..40).map(|t| Some(state(t))).collect();
            stay(&mut entries, &latent, 0.1);
            assert!((0..10).all(|t| entries[t] == Some(state(t))), "observed states stay as they are");
            entries.into_iter().flatten().collect()
        };
        // Half a meter becomes a few centimeters, without a jolt, and with all of the jitter.
        let creeps = stayed(0.1, 0.17);
        assert!((creeps[39].position.x - 0.07).abs() < 0.02 && creeps[39].heading_rad < 0.02, "{:?}", creeps[39]);
        let step_m = |t: usize| creeps[t].position.x - creeps[t - 1].position.x;
        assert!((11..40).all(|t| (step_m(t) - step_m(t - 1)).abs() < 0.005));
        let swings = |states: &[State]| (11..40).map(|t| (states[t].position.y - states[t - 1].position.y).abs()).sum();
        let [found, sampled]: [f64; 2] = [swings(&creeps), 29.0 * 0.02];
        assert!((found - sampled).abs() < 0.01, "{found}");
        // A start keeps nearly all of its motion, and an agent that rolled at present keeps all of it.
        assert!(stayed(0.1, 2.0)[39].position.x > 5.8);
        assert!((stayed(0.3, 0.17)[39].position.x - 0.51).abs() < 1e-9);
    }

    #[test]
    fn samples_stay_where_they_were_seen_to_stand() {
        let drives = [0.1, 5.0].map(|speed_mps| Drive::straight(0.0, 0.0, 0.0, speed_mps));
        let scene = Scene { n_history: 11, n_timesteps: 41, ..scene(&drives) };
        let batch = collator([&scene], StateParametrization::Motion).predictive(&[&scene], FutureValidity::Everything);
        let sample = &batch.decode_scenes(&batch.x0, &[&scene]).unwrap()[0];
        let way_m =
            |agent: usize| sample.state(agent, 40).unwrap().position.x - scene.state(agent, 10).unwrap().position.x;
        // 0.3 m and 15 m in the recording.
        assert!(way_m(0).abs() < 0.05 && (way_m(1) - 15.0).abs() < 0.1, "{} m, {} m", way_m(0), way_m(1));
    }

    #[test]
    fn a_recording_shows_whether_who_stands_is_exactly_still() {
        let path = |step_m: f64, n: usize| -> Vec<Option<State>> {
            (0..n).map(|t| Some(State { position: Vec2::new(step_m * t as f64, 0.0), ..State::default() })).collect()
        };
        assert!(stands_still(&[path(0.0, 5), path(1.0, 9)]) && !stands_still(&[path(0.002, 5), path(1.0, 9)]));
        assert!(stands_still(&[path(0.0, 5), path(0.002, 5)]) && !stands_still(&[path(0.0, 5), path(0.002, 6)]));
        assert!(stands_still(&[path(1.0, 9)]), "nobody stands");
        let mut gap = path(0.002, 3);
        gap[1] = None;
        assert!(stands_still(&[gap]), "a step goes from one timestep to the next");
    }

    #[test]
    fn velocities_are_those_at_the_timesteps() {
        // x = 3 t + 2 t², observed at first: a speed of 3 + 4 t.
        let at = |t: usize| 3.0 * (0.1 * t as f64) + 2.0 * (0.1 * t as f64).powi(2);
        let state =
            |t: usize| State { position: Vec2::new(at(t), 0.0), velocity: Vec2::new(9.0, 9.0), ..State::default() };
        let mut entries: Vec<Option<State>> = (0..7).map(|t| (t != 3).then(|| state(t))).collect();
        derive_motion(&mut entries, &[0, 1, 1, 1, 1, 1, 1], 0.1, HeadingSource::Velocity);
        assert_eq!(entries[0].unwrap().velocity, Vec2::new(9.0, 9.0), "observed states stay as they are");
        // Before and after the gap there are two positions in a row, or three.
        for t in [1, 2, 4, 5, 6] {
            let found = entries[t].unwrap().velocity;
            assert!(found.distance(Vec2::new(3.0 + 0.4 * t as f64, 0.0)) < 1e-9, "{t}: {found:?}");
        }
        let mut lonely = vec![None, Some(state(1)), Some(state(2)), None, Some(state(4))];
        derive_motion(&mut lonely, &[1; 5], 0.1, HeadingSource::Velocity);
        let speeds: Vec<f64> = lonely.iter().flatten().map(State::speed_mps).collect();
        assert!(
            speeds.iter().zip([3.6, 3.6, 0.0]).all(|(found, expected)| (found - expected).abs() < 1e-9),
            "{speeds:?}"
        );
    }

    #[test]
    fn headings_of_datasets_without_them_are_held_while_slow() {
        // Rolls out from 1.9 m/s, with noise of a centimeter across that is equal at every third timestep.
        let noise = |t: usize| if t.is_multiple_of(3) { 0.01 } else { -0.01 };
        let at = |t: usize| Vec2::new(0.19 * t as f64 - 0.002 * (t * t) as f64, noise(t));
        let entry = |t: usize| Some(State { position: at(t), ..State::default() });
        let turned_rad = |headings| {
            let mut entries: Vec<Option<State>> = (0..40).map(entry).collect();
            let latent: Vec<u8> = (0..40).map(|t| u8::from(t >= 10)).collect();
            derive_motion(&mut entries, &latent, 0.1, headings);
            let headings: Vec<f64> = entries.iter().flatten().map(|state| state.heading_rad).collect();
            headings.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
        };
        assert!(turned_rad(HeadingSource::Motion) < 0.025);
        assert!(turned_rad(HeadingSource::Velocity) > 0.1);
        assert_eq!(turned_rad(HeadingSource::Generated), 0.0);
    }

    /// A car of 4 m that drives at 8 m/s along x and, from 1 s on, at `aside_mps` along y; at all times turned by
    /// `heading_rad`. The first 10 of 40 states are given.
    fn sliding(aside_mps: f64, heading_rad: f64) -> (Vec<Option<State>>, Vec<u8>) {
        let state = |t: usize| State {
            position: Vec2::new(0.8 * t as f64, 0.1 * aside_mps * (t as f64 - 10.0).max(0.0)),
            heading_rad,
            velocity: Vec2::new(8.0, if t > 10 { aside_mps } else { 0.0 }),
        };
        let latent = (0..40).map(|t| u8::from(t >= 10)).collect();
        ((0..40).map(|t| Some(state(t))).collect(), latent)
    }

    #[test]
    fn who_is_moved_aside_turns() {
        let (mut entries, latent) = sliding(1.0, 0.0);
        turn_into_motion(&mut entries, &latent, 0.1, 4.0);
        let course_rad = 0.125f64.atan();
        let headings: Vec<f64> = entries.iter().map(|entry| entry.unwrap().heading_rad).collect();
        assert!(headings[..9].iter().all(|heading| *heading == 0.0), "{headings:?}");
        // Within half a second, without a step.
        assert!(headings[13..].iter().all(|heading| (heading - course_rad).abs() < 1e-12), "{headings:?}");
        assert!(
            headings.windows(2).all(|pair| (0.0..0.35 * course_rad).contains(&(pair[1] - pair[0]))),
            "{headings:?}"
        );
        let positions = |entries: &[Option<State>]| entries.iter().map(|e| e.unwrap().position).collect::<Vec<_>>();
        assert_eq!(positions(&entries), positions(&sliding(1.0, 0.0).0));
    }

    #[test]
    fn headings_that_turning_or_the_recording_explains_stay() {
        // Around a circle of 10 m at 5 m/s, about an axle 1.5 m behind the center: 8.5 degrees of slip.
        let (radius_m, rate_radps): (f64, f64) = (10.0, 0.5);
        let slip_rad = (1.5 * rate_radps / 5.0_f64).atan();
        let at = |t: usize| {
            let angle_rad = 0.1 * rate_radps * t as f64;
            State {
                position: Vec2::from_angle(angle_rad - FRAC_PI_2) * radius_m,
                heading_rad: angle_rad - slip_rad,
                velocity: Vec2::from_angle(angle_rad) * 5.0,
            }
        };
        let circle: Vec<Option<State>> = (0..40).map(|t| Some(at(t))).collect();
        let latent: Vec<u8> = (0..40).map(|t| u8::from(t >= 10)).collect();
        let mut turned = circle.clone();
        turn_into_motion(&mut turned, &latent, 0.1, 4.0);
        assert_eq!(turned, circle);
        // Headings that are off by as much in the observed states; a vehicle that is driven backward.
        for (aside_mps, heading_rad) in [(0.0, 0.05), (0.0, std::f64::consts::PI)] {
            let (mut entries, latent) = sliding(aside_mps, heading_rad);
            let before = entries.clone();
            turn_into_motion(&mut entries, &latent, 0.1, 4.0);
            assert_eq!(entries, before);
        }
    }
}
