//! The states of a smoothed Argoverse 1 track at the even times of a scene.
//!
//! Timesteps are 0.1 s apart and counted from the present, whatever the times of the rows, which are 0.02 to 0.5 s
//! apart. Observed states do not depend on the future: states up to the present are smoothed from rows up to the
//! present alone, and later states continue from there, smoothed from the rest.

use super::kinematics::DerivedStates;
use super::smoother::{Estimate, Node, likeliest_noise_m, smooth};
use super::{DT_S, RECORDED};
use crate::geometry::Vec2;
use crate::scene::{RecordedPosition, State, motion_heading};

/// A track has a timestep if one of its rows is this near, seconds, or if the rows around the timestep are consecutive
/// in the file.
const NEAR_S: f64 = DT_S / 2.0;
/// The tolerance before the first and after the last time of the file, seconds: 49 steps may take slightly less than
/// 4.9 s.
const NEAR_END_S: f64 = 1.5 * DT_S;

/// Times closer than this are equal, seconds.
const SAME_S: f64 = 1e-6;

/// A row of the track.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimedRow {
    /// Index of the time among those of the file.
    pub(super) time_idx: usize,
    /// Seconds after the present.
    pub(super) time_s: f64,
    /// Meters.
    pub(super) position: Vec2,
}

/// The states of one track at timesteps 0 to `n_timesteps`. `rows` are by ascending time; the file has `n_times` times.
pub(super) fn smoothed_states(rows: &[TimedRow], n_times: usize, n_timesteps: usize) -> DerivedStates {
    let n_past = rows.partition_point(|row| row.time_idx < RECORDED.n_history);
    let (past, future) = rows.split_at(n_past);
    let past_nodes = nodes(past, past, RECORDED.n_history, 0..RECORDED.n_history.min(n_timesteps));
    let future_nodes = nodes(future, rows, n_times, RECORDED.n_history..n_timesteps);

    let mut estimates: Vec<Option<Estimate>> = vec![None; n_timesteps];
    let mut fill = |nodes: &[(Node, Option<usize>)], noise_of: &[Node], before: Option<(f64, Estimate)>| {
        let only_nodes: Vec<Node> = nodes.iter().map(|(node, _)| *node).collect();
        let smoothed = smooth(&only_nodes, likeliest_noise_m(noise_of), before);
        for ((_, timestep), estimate) in nodes.iter().zip(&smoothed) {
            if let Some(timestep) = timestep {
                estimates[*timestep] = Some(*estimate);
            }
        }
        only_nodes.last().zip(smoothed.last()).map(|(node, estimate)| (node.time_s, estimate.for_certain()))
    };
    let recorded = |rows: &[TimedRow]| -> Vec<Node> {
        rows.iter().map(|row| Node { time_s: row.time_s, recorded: Some(row.position) }).collect()
    };
    let present = fill(&past_nodes, &recorded(past), None);
    fill(&future_nodes, &recorded(rows), present);

    let (states, held_headings, headings_from) = with_headings(&estimates);
    let recorded = rows.iter().map(|row| RecordedPosition { time_s: row.time_s, position: row.position }).collect();
    DerivedStates { states, held_headings, headings_from, recorded }
}

/// The rows, and the `timesteps` at which the track exists, up to the first `n_times` times of the file.
fn nodes(
    rows: &[TimedRow],
    known: &[TimedRow],
    n_times: usize,
    timesteps: std::ops::Range<usize>,
) -> Vec<(Node, Option<usize>)> {
    let mut nodes: Vec<(Node, Option<usize>)> =
        rows.iter().map(|row| (Node { time_s: row.time_s, recorded: Some(row.position) }, None)).collect();
    for timestep in timesteps {
        let time_s = DT_S * (timestep as f64 - (RECORDED.n_history - 1) as f64);
        if !is_tracked(known, n_times, time_s) {
            continue;
        }
        match nodes.iter_mut().find(|(node, _)| (node.time_s - time_s).abs() < SAME_S) {
            Some((_, of_row)) => *of_row = Some(timestep),
            None => nodes.push((Node { time_s, recorded: None }, Some(timestep))),
        }
    }
    nodes.sort_by(|(a, _), (b, _)| a.time_s.total_cmp(&b.time_s));
    nodes
}

fn is_tracked(rows: &[TimedRow], n_times: usize, time_s: f64) -> bool {
    let after = rows.partition_point(|row| row.time_s < time_s);
    let (before, after) = (after.checked_sub(1).and_then(|before| rows.get(before)), rows.get(after));
    let is_near = |row: &TimedRow, is_at_end: bool| {
        (row.time_s - time_s).abs() <= SAME_S + if is_at_end { NEAR_END_S } else { NEAR_S }
    };
    before.zip(after).is_some_and(|(before, after)| after.time_idx == before.time_idx + 1)
        || before.is_some_and(|row| is_near(row, row.time_idx + 1 == n_times))
        || after.is_some_and(|row| is_near(row, row.time_idx == 0))
}

/// The estimates as states; whether each heading is held; and the first timestep with a known heading, if earlier ones
/// are placeholders because the track has not moved.
///
/// A heading is the direction of the last motion ([`motion_heading`]). Before its first motion, an agent has that
/// motion's heading if it is observed (or if the agent has no observed state).
fn with_headings(estimates: &[Option<Estimate>]) -> (Vec<Option<State>>, Vec<bool>, usize) {
    let told_rad = |timestep: usize| {
        let Estimate { position, velocity, .. } = estimates[timestep]?;
        let before = estimates[..timestep].iter().rev().flatten();
        motion_heading(position, velocity, before.map(|before| before.position))
    };
    let told_rad: Vec<Option<f64>> = (0..estimates.len()).map(told_rad).collect();
    let n_observed = RECORDED.n_history.min(estimates.len());
    let is_observed = estimates[..n_observed].iter().any(Option::is_some);
    let told_by = if is_observed { &told_rad[..n_observed] } else { &told_rad };
    let mut known_rad = told_by.iter().flatten().next().copied();
    let mut headings_from = if known_rad.is_none() { estimates.len() } else { 0 };
    let mut held_headings = vec![false; estimates.len()];
    let mut states = vec![None; estimates.len()];
    for (timestep, estimate) in estimates.iter().enumerate() {
        let Some(estimate) = estimate else { continue };
        let told = told_rad[timestep];
        if told.is_some() && known_rad.is_none() {
            headings_from = timestep;
        }
        known_rad = told.or(known_rad);
        held_headings[timestep] = told.is_none();
        let Estimate { position, velocity, .. } = *estimate;
        states[timestep] = Some(State { position, heading_rad: known_rad.unwrap_or(0.0), velocity });
    }
    (states, held_headings, headings_from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    /// Rows of an agent at `path(time)`, at uneven times, with noise of this standard deviation.
    fn rows(noise_m: f64, path: impl Fn(f64) -> Vec2) -> Vec<TimedRow> {
        let mut rng = Seed(11).rng();
        let times: Vec<f64> = (0..50).map(|i| 0.1 * f64::from(i - 19) + 0.03 * (rng.uniform() - 0.5)).collect();
        let row = |(time_idx, time_s): (usize, f64)| {
            let time_s = time_s - times[19];
            TimedRow { time_idx, time_s, position: path(time_s) + Vec2::new(rng.normal(), rng.normal()) * noise_m }
        };
        times.iter().copied().enumerate().map(row).collect()
    }

    fn at(timestep: usize) -> f64 {
        0.1 * (timestep as f64 - 19.0)
    }

    #[test]
    fn noise_and_uneven_times_are_gone() {
        // Braking from 12 m/s by 2 m/s².
        let path = |t: f64| Vec2::new(3000.0 + 12.0 * t - t * t, 500.0);
        let smoothed = smoothed_states(&rows(0.15, path), 50, 50);
        assert_eq!((smoothed.states.iter().flatten().count(), smoothed.headings_from), (50, 0));
        assert_eq!(smoothed.recorded.len(), 50);
        let states: Vec<State> = smoothed.states.into_iter().flatten().collect();
        for (timestep, state) in states.iter().enumerate() {
            assert!(state.position.distance(path(at(timestep))) < 0.35, "{timestep}: {state:?}");
            assert!(state.velocity.distance(Vec2::new(12.0 - 2.0 * at(timestep), 0.0)) < 1.5, "{timestep}: {state:?}");
            assert!(state.heading_rad.abs() < 0.15);
        }
        let accelerations = states.windows(2).map(|pair| (pair[1].velocity - pair[0].velocity).norm() / 0.1);
        assert!(accelerations.fold(0.0, f64::max) < 6.0);
        // Positions and velocities belong to one motion.
        for pair in states.windows(2) {
            let mean = (pair[0].velocity + pair[1].velocity) * 0.5;
            assert!(((pair[1].position - pair[0].position) * 10.0).distance(mean) < 0.3);
        }
    }

    #[test]
    fn the_past_does_not_see_the_future() {
        let straight = rows(0.1, |t| Vec2::new(8.0 * t, 0.0));
        let turning: Vec<TimedRow> = straight
            .iter()
            .map(|row| TimedRow { position: row.position + Vec2::new(0.0, 3.0 * row.time_s.max(0.0)), ..*row })
            .collect();
        let [a, b, alone] = [(&straight[..], 50, 50), (&turning[..], 50, 50), (&straight[..20], 20, 20)]
            .map(|(rows, n_times, n_timesteps)| smoothed_states(rows, n_times, n_timesteps).states);
        assert_eq!((&a[..20], &a[..20]), (&b[..20], &alone[..]));
        assert_ne!(a[20..], b[20..]);
    }

    #[test]
    fn who_stands_keeps_one_heading() {
        let standing = smoothed_states(&rows(0.2, |_| Vec2::new(7.0, 7.0)), 50, 50);
        assert_eq!(standing.headings_from, 50);
        assert!(standing.held_headings.iter().all(|held| *held));
        assert!(standing.states.iter().flatten().all(|state| state.heading_rad == 0.0));
        // Moves, then stands from half a second before the present on.
        let stopping = smoothed_states(&rows(0.1, |t| Vec2::new(0.0, 6.0 * t.min(-0.5))), 50, 50);
        let headings: Vec<f64> = stopping.states.iter().flatten().map(|state| state.heading_rad).collect();
        assert!(headings.iter().all(|heading| (heading - std::f64::consts::FRAC_PI_2).abs() < 0.2), "{headings:?}");
        assert!(!stopping.held_headings[5] && stopping.held_headings[49]);
    }

    #[test]
    fn timesteps_are_tracked_where_rows_are() {
        let all = rows(0.0, |t| Vec2::new(t, 0.0));
        let tracked = |rows: &[TimedRow]| -> Vec<usize> {
            let states = smoothed_states(rows, 50, 50).states;
            (0..50).filter(|timestep| states[*timestep].is_some()).collect()
        };
        assert_eq!(tracked(&all[10..30]), (10..30).collect::<Vec<_>>());
        let gap = [&all[..5], &all[8..]].concat();
        assert_eq!(tracked(&gap), (0..5).chain(8..50).collect::<Vec<_>>());
        // Rows of a file that skipped its times still follow each other.
        let slow: Vec<TimedRow> = (0..50).map(|i| TimedRow { time_s: 3.0 * at(i), ..all[i] }).collect();
        assert_eq!(tracked(&slow), (0..50).collect::<Vec<_>>());
        assert_eq!(tracked(&all[25..26]), [25]);
        assert!(tracked(&[]).is_empty());
    }
}
