//! Recorded headings that cannot be: numbers that stand for none, and turns that no vehicle makes.
//!
//! Such headings are taken as blank: they follow from the motion, as those that are not recorded. A heading is believed
//! if it agrees with the motion, or turns evenly from one that does.

use super::left_out::LeftOut;
use super::resample::TimedState;
use super::rows::{Group, Rows};
use crate::geometry::{angle_difference, wrap_angle};
use crate::scene::AgentClass;
use std::f64::consts::{FRAC_PI_4, TAU};

/// Between rows closer in time than this, seconds, vehicles turn by less than this angle, radians, or at this rate,
/// radians per second: 10 m/s on a circle of 5 m.
const NEAR_S: f64 = 1.0;
const MAX_TURN_RAD: f64 = FRAC_PI_4;
const MAX_RATE_RADPS: f64 = 2.0;
/// Vehicles faster than this show where they point, and slower than this stand, m/s.
const MOVING_MPS: f64 = 2.0;
const STANDING_MPS: f64 = 0.5;
/// This share of the rows of standing vehicles has a heading of 0 if it stands for none.
const MIN_ZERO_SHARE: f64 = 0.9;

impl Rows<'_> {
    /// Takes headings of an agent as blank that cannot be, and counts them.
    pub(super) fn blank_headings(
        &self,
        (id, class): (&str, AgentClass),
        rows: &[u32],
        states: &mut [TimedState],
        left_out: &mut LeftOut,
    ) {
        let Some(headings) = self.table.number(self.mapping.columns.heading.as_deref()) else { return };
        let values: Vec<f64> = rows.iter().map(|row| headings[*row as usize]).collect();
        let is_own = |at: &&usize| self.is_own(states[**at].time_s);
        let place = |at: usize| format!("{}, {}: track {id}", self.file, self.table.place_of(rows[at] as usize));
        let none = stand_ins(&values, self.mapping.heading.circle());
        if let Some(first) = none.first() {
            let detail = format!("{} has a heading of {}, which is taken as blank", place(*first), values[*first]);
            left_out.note("headings_beyond_a_circle", none.iter().filter(is_own).count(), &detail);
        }
        none.iter().for_each(|at| states[*at].heading_rad = None);
        if !class.is_motorized() && class != AgentClass::Cyclist {
            return;
        }
        if self.rests_at_zero {
            let zeros = (0..states.len()).filter(|at| values[*at] == 0.0 && is_at_rest(states, *at));
            let zeros: Vec<usize> = zeros.collect();
            let first = zeros.first().map_or_else(String::new, |first| place(*first));
            let detail = format!("{first} stands with a heading of 0, as most who stand: these are taken as blank");
            let n_own = zeros.iter().filter(|at| self.is_own(states[**at].time_s)).count();
            left_out.note("headings_of_0_at_rest", n_own, &detail);
            zeros.iter().for_each(|at| states[*at].heading_rad = None);
        }
        let Some(Turns { from, to, wrong }) = impossible_turns(states) else { return };
        let [from_rad, to_rad] = [from, to].map(|at| states[at].heading_rad.unwrap_or_default());
        let turn_deg = angle_difference(to_rad, from_rad).to_degrees().abs();
        let turns = format!("turns by {turn_deg:.0} degrees within {:.2} s", states[to].time_s - states[from].time_s);
        let n_own = wrong.iter().filter(|at| self.is_own(states[**at].time_s)).count();
        if wrong.is_empty() {
            let detail = format!(
                "{} {turns}, and most of its headings contradict its motion; they are kept: are columns.heading, \
                 heading and y_points_down of ingest.table right?",
                place(to)
            );
            left_out.note("tracks_that_turn_at_once", usize::from(self.is_own(states[to].time_s)), &detail);
        }
        let (n, of) = (wrong.len(), states.len());
        let detail = format!("{} {turns}; {n} of its {of} headings are taken as blank", place(to));
        left_out.note("headings_that_no_vehicle_turns_to", n_own, &detail);
        wrong.iter().for_each(|at| states[*at].heading_rad = None);
    }

    /// Whether a heading of 0 stands for none in the rows of standing agents: most of these have it, and one that moved
    /// turns to it at once.
    pub(super) fn zero_at_rest(&self, groups: &[Group]) -> bool {
        let Some(headings) = self.table.number(self.mapping.columns.heading.as_deref()) else { return false };
        let is_zero = |row: u32| headings[row as usize] == 0.0;
        let turned_rad = |row: u32| wrap_angle(headings[row as usize] * TAU / self.mapping.heading.circle()).abs();
        let pairs = || groups.iter().flat_map(|group| &group.tracks).flat_map(|(_, rows)| rows.windows(2));
        let mps = |pair: &[u32]| {
            let gap_s = self.time_s(pair[1]) - self.time_s(pair[0]);
            (gap_s > 0.0 && gap_s <= NEAR_S).then(|| self.position(pair[0]).distance(self.position(pair[1])) / gap_s)
        };
        let stands = |pair: &[u32]| mps(pair).is_some_and(|mps| mps < STANDING_MPS);
        let turns_to_zero = |pair: &[u32]| is_zero(pair[1]) && turned_rad(pair[0]) > MAX_TURN_RAD && stands(pair);
        if !pairs().any(turns_to_zero) {
            return false;
        }
        let standing = pairs().filter(|pair| stands(pair)).map(|pair| is_zero(pair[1]));
        let (n, n_zero) = standing.fold((0_u32, 0_u32), |(n, n_zero), zero| (n + 1, n_zero + u32::from(zero)));
        n > 0 && f64::from(n_zero) >= MIN_ZERO_SHARE * f64::from(n)
    }
}

/// The indices of values that stand for no heading, such as 999 or -9999: whole numbers beyond a circle, and half a
/// circle or more from the values around, which may be added up over turns.
fn stand_ins(values: &[f64], circle: f64) -> Vec<usize> {
    let is_odd = |value: f64| value.abs() > circle && value.fract() == 0.0;
    if !values.iter().any(|value| is_odd(*value)) {
        return Vec::new();
    }
    let (mut found, mut end) = (Vec::new(), 0);
    for same in values.chunk_by(|a, b| a == b) {
        let start = end;
        end += same.len();
        let is_finite = |value: &&f64| value.is_finite();
        let around = [values[..start].iter().rfind(is_finite), values[end..].iter().find(is_finite)];
        if is_odd(same[0]) && around.into_iter().flatten().all(|other| (other - same[0]).abs() >= circle / 2.0) {
            found.extend(start..end);
        }
    }
    found
}

/// The first turn that no vehicle makes, and the headings that are wrong, none if most of the track is.
#[derive(Debug, PartialEq)]
struct Turns {
    from: usize,
    to: usize,
    wrong: Vec<usize>,
}

/// The turns of the rows of a vehicle, by ascending time; `None` if all can be.
fn impossible_turns(states: &[TimedState]) -> Option<Turns> {
    let known: Vec<(usize, f64)> =
        states.iter().enumerate().filter_map(|(at, state)| Some((at, state.heading_rad?))).collect();
    let is_turn = |(from, a): &(usize, f64), (to, b): &(usize, f64)| {
        let gap_s = states[*to].time_s - states[*from].time_s;
        // Most are equal: the difference is the quick question.
        (a - b).abs() > MAX_TURN_RAD
            && gap_s <= NEAR_S
            && angle_difference(*b, *a).abs() > MAX_TURN_RAD.max(MAX_RATE_RADPS * gap_s)
    };
    let turn = known.windows(2).find(|pair| is_turn(&pair[0], &pair[1]))?;
    let agrees = |a: f64, b: f64| angle_difference(a, b).abs() < MAX_TURN_RAD;
    let runs: Vec<&[(usize, f64)]> = known.chunk_by(|a, b| !is_turn(a, b)).collect();
    // The rows of each run whose headings agree with the motion, and that contradict it.
    let evidence = |run: &&[(usize, f64)]| {
        let with_motion = run.iter().filter_map(|(at, heading_rad)| Some((motion_rad(states, *at)?, *heading_rad)));
        let (with, against): (Vec<_>, Vec<_>) = with_motion.partition(|(motion_rad, own)| agrees(*motion_rad, *own));
        (with.len(), against.len())
    };
    let evidence: Vec<(usize, usize)> = runs.iter().map(evidence).collect();
    let n_with: usize = evidence.iter().filter(|(with, against)| with > against).map(|(with, _)| with).sum();
    let n_in_all: usize = evidence.iter().map(|(with, against)| with + against).sum();
    let mut believed = vec![false; runs.len()];
    if n_in_all > 0 {
        let shown = runs.iter().zip(&evidence).find(|(_, (with, against))| with > against);
        let mut known_rad = shown.map(|(run, _)| run[0].1);
        for ((run, evidence), believed) in runs.iter().zip(evidence).zip(&mut believed) {
            *believed = match evidence {
                (0, 0) => known_rad.is_some_and(|known_rad| agrees(known_rad, run[0].1)),
                (with, against) => with > against,
            };
            known_rad = if *believed { run.last().map(|(_, rad)| *rad) } else { known_rad };
        }
    } else {
        // It never moves: the heading of most rows counts.
        let most_rad = runs.iter().max_by_key(|run| run.len()).map_or(0.0, |run| run[0].1);
        if 2 * known.iter().filter(|(_, rad)| agrees(*rad, most_rad)).count() > known.len() {
            believed.iter_mut().zip(&runs).for_each(|(believed, run)| *believed = agrees(run[0].1, most_rad));
        }
    }
    let is_mended = 2 * n_with >= n_in_all && believed.contains(&true);
    let wrong = runs.iter().zip(&believed).filter(|(_, believed)| is_mended && !**believed);
    let wrong = wrong.flat_map(|(run, _)| run.iter().map(|(at, _)| *at)).collect();
    Some(Turns { from: turn[0].0, to: turn[1].0, wrong })
}

/// The direction in which an agent moves at a row, if it is fast.
fn motion_rad(states: &[TimedState], at: usize) -> Option<f64> {
    let (mps, rad) = motion(states, at)?;
    (mps > MOVING_MPS).then_some(rad)
}

fn is_at_rest(states: &[TimedState], at: usize) -> bool {
    motion(states, at).is_none_or(|(mps, _)| mps < STANDING_MPS)
}

/// Speed, m/s, and direction of the motion between the rows around one.
fn motion(states: &[TimedState], at: usize) -> Option<(f64, f64)> {
    let (before, after) = (states[at.saturating_sub(1)], states[(at + 1).min(states.len() - 1)]);
    let (step, gap_s) = (after.position - before.position, after.time_s - before.time_s);
    (gap_s > 0.0 && gap_s <= 2.0 * NEAR_S).then(|| (step.norm() / gap_s, step.angle()))
}
