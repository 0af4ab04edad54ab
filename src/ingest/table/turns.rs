//! Recorded headings that cannot be: numbers that stand for none, and turns that no vehicle makes.
//!
//! They are taken as blank, and follow from the motion as those that are not recorded.

use super::headings::{Chords, headings};
use super::left_out::LeftOut;
use super::mapping::HeadingUnit;
use super::resample::TimedState;
use super::rows::Rows;
use crate::geometry::{Vec2, angle_difference};
use crate::ingest::recorded_track::{HeadingSource, Observation};
use crate::scene::AgentClass;
use std::f64::consts::{FRAC_PI_4, TAU};

/// Between rows closer in time than this, seconds, vehicles turn by less than this angle, radians, or at this rate,
/// radians per second: 10 m/s on a circle of 5 m.
const NEAR_S: f64 = 1.0;
const MAX_TURN_RAD: f64 = FRAC_PI_4;
const MAX_RATE_RADPS: f64 = 2.0;

impl Rows<'_> {
    /// Takes headings of an agent as blank that cannot be, and counts them.
    pub(super) fn blank_headings(
        &self,
        (id, class, chords): (&str, AgentClass, Chords),
        rows: &[u32],
        states: &mut [TimedState],
        left_out: &mut LeftOut,
    ) {
        let Some(recorded) = self.table.number(self.mapping.columns.heading.as_deref()) else { return };
        let values: Vec<f64> = rows.iter().map(|row| recorded[*row as usize]).collect();
        let place = |at: usize| format!("{}, {}: track {id}", self.file, self.table.place_of(rows[at] as usize));
        let mut blank = |states: &mut [TimedState], found: &[usize], what, why: &dyn Fn(usize) -> String| {
            let Some(first) = found.first() else { return };
            let n_own = found.iter().filter(|at| self.is_own(states[**at].time_s)).count();
            left_out.note(what, n_own, &format!("{} {}: taken as blank", place(*first), why(*first)));
            found.iter().for_each(|at| states[*at].heading_rad = None);
        };
        let circle = if self.mapping.heading == HeadingUnit::Radians { TAU } else { 360.0 };
        let none = stand_ins(&values, circle);
        blank(states, &none, "headings_beyond_a_circle", &|at| format!("has a heading of {}", values[at]));
        let Some(turn) = chords.is_wheeled.then(|| impossible_turn(states)).flatten() else { return };
        match off_their_motion(states, class, chords) {
            Some(wrong) => blank(states, &wrong, "headings_that_no_vehicle_turns_to", &|at| {
                format!("has a heading of {} at once, as {} of its {} rows", values[at], wrong.len(), rows.len())
            }),
            None => {
                let detail = format!(
                    "{} turns at once, as no vehicle does, and most of its headings contradict its motion; they are \
                     kept: are heading, columns.heading and y_points_down of ingest.table right?",
                    place(turn)
                );
                left_out.note("tracks_that_turn_at_once", usize::from(self.is_own(states[turn].time_s)), &detail);
            }
        }
    }
}

/// The indices of values that stand for no heading, such as 999 or -9999: whole numbers beyond two circles, and half a
/// circle or more from the values around, which may be added up over turns.
fn stand_ins(values: &[f64], circle: f64) -> Vec<usize> {
    let is_odd = |value: f64| value.abs() > 2.0 * circle && value.fract() == 0.0;
    let (mut found, mut end) = (Vec::new(), 0);
    for same in values.chunk_by(|a, b| a == b) {
        let start = end;
        end += same.len();
        let is_far = |other: &f64| (other - same[0]).abs() >= circle / 2.0;
        let is_finite = |value: &&f64| value.is_finite();
        if is_odd(same[0])
            && values[..start].iter().rfind(is_finite).is_none_or(is_far)
            && values[end..].iter().find(is_finite).is_none_or(is_far)
        {
            found.extend(start..end);
        }
    }
    found
}

/// The first row, by ascending time, to whose heading no vehicle turns from the one before.
fn impossible_turn(states: &[TimedState]) -> Option<usize> {
    let mut last: Option<(f64, f64)> = None;
    states.iter().position(|state| {
        let Some(now_rad) = state.heading_rad else { return false };
        last.replace((state.time_s, now_rad)).is_some_and(|(time_s, last_rad)| {
            let gap_s = state.time_s - time_s;
            // Most are nearly equal: the difference is the quick question.
            (now_rad - last_rad).abs() > MAX_TURN_RAD
                && gap_s <= NEAR_S
                && angle_difference(now_rad, last_rad).abs() > MAX_TURN_RAD.max(MAX_RATE_RADPS * gap_s)
        })
    })
}

/// The rows of a vehicle whose headings contradict those by its motion, or those of most rows if it never moves; `None`
/// if most of them do.
fn off_their_motion(states: &[TimedState], class: AgentClass, chords: Chords) -> Option<Vec<usize>> {
    let seen = |(at, state): (usize, &TimedState)| Observation {
        frame: at as i64,
        position: state.position,
        velocity: Vec2::ZERO,
        heading_rad: None,
    };
    let seen: Vec<Observation> = states.iter().enumerate().map(seen).collect();
    let by_motion = headings(&seen, class, chords);
    let off = |by_rad: &dyn Fn(usize) -> f64| -> Option<Vec<usize>> {
        let known = || (0..states.len()).filter_map(|at| Some((at, states[at].heading_rad?)));
        let is_off = |(at, rad): &(usize, f64)| angle_difference(*rad, by_rad(*at)).abs() > MAX_TURN_RAD;
        let off: Vec<usize> = known().filter(is_off).map(|(at, _)| at).collect();
        (2 * off.len() < known().count()).then_some(off)
    };
    if by_motion.iter().any(|(_, source)| *source != HeadingSource::Unknown) {
        return off(&|at| by_motion[at].0);
    }
    let some_rad = [0, 1, 2].into_iter().filter_map(|third| states[third * (states.len() - 1) / 2].heading_rad);
    some_rad.into_iter().find_map(|rad| off(&|_| rad))
}
