//! The motion of a track at the frames of scenes, from rows at any times.

use crate::geometry::{Vec2, angle_difference};
use crate::ingest::recorded_track::DT_S;

/// Times closer than this are equal, seconds.
const SAME_S: f64 = 1e-4;

/// A row of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TimedState {
    /// Seconds after frame 0.
    pub(super) time_s: f64,
    /// Meters.
    pub(super) position: Vec2,
    /// Radians, if recorded.
    pub(super) heading_rad: Option<f64>,
}

/// The states at all frames, [`DT_S`] apart, that have a row or lie between two rows at most `max_gap_s` apart.
///
/// Positions between rows are on the cubic with their velocities, each that of the parabola through a row and its
/// neighbors; headings turn evenly. `rows` are by ascending time.
pub(super) fn resampled(rows: &[TimedState], max_gap_s: f64) -> Vec<(i64, TimedState)> {
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return Vec::new() };
    let first_frame = ((first.time_s - SAME_S) / DT_S).ceil() as i64;
    let last_frame = ((last.time_s + SAME_S) / DT_S).floor() as i64;
    let mut next = 0;
    let mut found = Vec::new();
    for frame in first_frame..=last_frame {
        let time_s = frame as f64 * DT_S;
        while next + 1 < rows.len() && rows[next].time_s < time_s - SAME_S {
            next += 1;
        }
        let after = rows[next];
        if (after.time_s - time_s).abs() <= SAME_S {
            found.push((frame, TimedState { time_s, ..after }));
            continue;
        }
        let Some(before) = next.checked_sub(1).map(|before| rows[before]) else { continue };
        let gap_s = after.time_s - before.time_s;
        if gap_s > max_gap_s + SAME_S {
            continue;
        }
        let share = (time_s - before.time_s) / gap_s;
        let heading_rad = before.heading_rad.zip(after.heading_rad);
        let heading_rad = heading_rad.map(|(from, to)| from + share * angle_difference(to, from));
        let position =
            on_cubic([before, after], [velocity(rows, next - 1, max_gap_s), velocity(rows, next, max_gap_s)], share);
        found.push((frame, TimedState { time_s, position, heading_rad }));
    }
    found
}

/// The velocity at a row: of the parabola through it and its neighbors, or toward the only neighbor within the gap.
fn velocity(rows: &[TimedState], at: usize, max_gap_s: f64) -> Vec2 {
    let slope = |from: usize| {
        let (from, to) = (rows.get(from)?, rows.get(from + 1)?);
        let gap_s = to.time_s - from.time_s;
        (gap_s <= max_gap_s + SAME_S).then(|| ((to.position - from.position) * (1.0 / gap_s), gap_s))
    };
    match (at.checked_sub(1).and_then(slope), slope(at)) {
        (Some((came, before_s)), Some((goes, after_s))) => {
            (came * after_s + goes * before_s) * (1.0 / (before_s + after_s))
        }
        (Some((only, _)), None) | (None, Some((only, _))) => only,
        (None, None) => Vec2::ZERO,
    }
}

/// The point at this share of the time on the cubic between two rows with these velocities (Hermite).
fn on_cubic([from, to]: [TimedState; 2], [start, end]: [Vec2; 2], share: f64) -> Vec2 {
    let (s, gap_s) = (share, to.time_s - from.time_s);
    let (s2, s3) = (s * s, s * s * s);
    from.position * (2.0 * s3 - 3.0 * s2 + 1.0)
        + start * (gap_s * (s3 - 2.0 * s2 + s))
        + to.position * (3.0 * s2 - 2.0 * s3)
        + end * (gap_s * (s3 - s2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(times_s: &[f64], position: impl Fn(f64) -> Vec2) -> Vec<TimedState> {
        let row =
            |time_s: &f64| TimedState { time_s: *time_s, position: position(*time_s), heading_rad: Some(*time_s) };
        times_s.iter().map(row).collect()
    }

    #[test]
    fn motion_at_constant_acceleration_is_exact_at_any_rate() {
        let parabola = |t: f64| Vec2::new(10.0 * t - t * t, 2.0 + 0.5 * t * t);
        for rate_hz in [25.0, 15.0, 7.5, 50.0] {
            let times: Vec<f64> = (0..=(4.0 * rate_hz) as usize).map(|i| 0.3 + i as f64 / rate_hz).collect();
            let found = resampled(&rows(&times, parabola), 1.0);
            assert_eq!((found[0].0, found.len()), (3, 41), "{rate_hz}");
            // At both ends, the velocity is that of a line.
            for (frame, state) in found.iter().filter(|(frame, _)| (7..=39).contains(frame)) {
                let expected = parabola(*frame as f64 * DT_S);
                assert!(state.position.distance(expected) < 1e-9, "{rate_hz} {frame}: {state:?} {expected:?}");
                assert!((state.heading_rad.unwrap() - *frame as f64 * DT_S).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn motion_at_constant_acceleration_is_exact_between_uneven_rows() {
        let parabola = |t: f64| Vec2::new(10.0 * t - t * t, 2.0 + 0.5 * t * t);
        let found = resampled(&rows(&[0.03, 0.12, 0.47, 0.55, 0.98, 1.04], parabola), 1.0);
        // At both ends, the velocity is that of a line.
        let between: Vec<_> = found.iter().filter(|(frame, _)| (2..=9).contains(frame)).collect();
        assert_eq!(between.len(), 8);
        for (frame, state) in between {
            let expected = parabola(*frame as f64 * DT_S);
            assert!(state.position.distance(expected) < 1e-9, "{frame}: {state:?} {expected:?}");
        }
    }

    #[test]
    fn cubics_between_two_rows_are_exact() {
        let cubic = |t: f64| Vec2::new(t * t * t, 2.0 * t * t * t - t);
        let [from, to] = [1.0, 3.0].map(|time_s| TimedState { time_s, position: cubic(time_s), heading_rad: None });
        let velocities = [1.0, 3.0].map(|t: f64| Vec2::new(3.0 * t * t, 6.0 * t * t - 1.0));
        for share in [0.0, 0.25, 0.6, 1.0] {
            let found = on_cubic([from, to], velocities, share);
            assert!(found.distance(cubic(1.0 + 2.0 * share)) < 1e-12, "{share}: {found:?}");
        }
    }

    #[test]
    fn rows_at_frames_stay_as_they_are_and_long_gaps_stay_empty() {
        let times = [0.1, 0.2, 0.3, 0.6, 0.7, 2.0, 2.1];
        let wild = |t: f64| Vec2::new((37.0 * t).sin(), t);
        let found = resampled(&rows(&times, wild), 1.0);
        let frames: Vec<i64> = found.iter().map(|(frame, _)| *frame).collect();
        assert_eq!(frames, [1, 2, 3, 4, 5, 6, 7, 20, 21]);
        for (frame, state) in found.iter().filter(|(frame, _)| ![4, 5].contains(frame)) {
            let seen = state.position;
            assert_eq!(seen, wild(times[times.iter().position(|t| (t * 10.0).round() as i64 == *frame).unwrap()]));
        }
        assert_eq!(resampled(&rows(&times, wild), 0.0).len(), 7, "no gap is filled in");
        assert_eq!(resampled(&rows(&[0.14, 0.16], wild), 1.0), []);
        assert_eq!(resampled(&[], 1.0), []);
    }

    #[test]
    fn headings_turn_the_short_way() {
        let row =
            |time_s: f64, heading_rad: f64| TimedState { time_s, position: Vec2::ZERO, heading_rad: Some(heading_rad) };
        let found = resampled(&[row(0.05, 3.1), row(0.15, -3.1)], 1.0);
        let expected = 3.1 + 0.5 * (std::f64::consts::TAU - 6.2);
        assert!((found[0].1.heading_rad.unwrap() - expected).abs() < 1e-12, "{found:?}");
    }
}
