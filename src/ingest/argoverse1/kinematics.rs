//! Headings and velocities from positions, since Argoverse 1 records nothing else.
//!
//! Observed states must not depend on the future: states up to the present are derived from observed positions alone.

use crate::geometry::Vec2;
use crate::scene::{RecordedPosition, State};

/// Displacements shorter than this define no direction, meters: positions jitter by some decimeters.
const MIN_DISPLACEMENT_M: f64 = 1.0;

/// The kinematics of one track.
#[derive(Debug)]
pub(super) struct DerivedStates {
    /// One entry a timestep.
    pub(super) states: Vec<Option<State>>,
    /// Whether the heading is held because the agent moves too slowly, one entry a timestep.
    pub(super) held_headings: Vec<bool>,
    /// The first timestep with a heading of its own: earlier ones are placeholders because the track has not moved.
    pub(super) headings_from: usize,
    /// The recorded positions, if the states are smoothed.
    pub(super) recorded: Vec<RecordedPosition>,
}

/// The states of one track as recorded, without smoothing.
///
/// `positions` and `timestamps_s` have one entry a timestep; the first `n_observed` are the past.
///
/// - Velocity: backward difference over the actual time between tracked timesteps; forward difference for the first
///   one, 0 where that would look from the past into the future.
/// - Heading: direction of the displacement since the track was last 1 m away; before it has moved that far, the
///   direction of its first such motion within the past; headings of the future are held while it stands.
pub(super) fn derive_states(positions: &[Option<Vec2>], timestamps_s: &[f64], n_observed: usize) -> DerivedStates {
    let tracked: Vec<(usize, Vec2)> = positions.iter().enumerate().filter_map(|(t, p)| p.map(|p| (t, p))).collect();
    let n_past = tracked.partition_point(|(timestep, _)| *timestep < n_observed);
    let first_of_past = first_motion(&tracked[..n_past]);
    let mut known = first_of_past.or_else(|| if n_past == 0 { first_motion(&tracked) } else { None });
    let mut headings_from = if known.is_none() { positions.len() } else { 0 };
    let mut states = vec![None; positions.len()];
    let mut held_headings = vec![false; positions.len()];
    for (i, &(timestep, position)) in tracked.iter().enumerate() {
        let backwards = tracked[..i].iter().rev().find(|(_, p)| is_displaced(*p, position));
        if let Some((_, from)) = backwards {
            if known.is_none() {
                headings_from = timestep;
            }
            known = Some((position - *from).angle());
        }
        held_headings[timestep] = backwards.is_none();
        let velocity = velocity(&tracked, timestamps_s, i, n_past);
        states[timestep] = Some(State { position, heading_rad: known.unwrap_or(0.0), velocity });
    }
    DerivedStates { states, held_headings, headings_from, recorded: Vec::new() }
}

/// Direction from the first position to the first one at least 1 m from it.
fn first_motion(tracked: &[(usize, Vec2)]) -> Option<f64> {
    let (_, start) = *tracked.first()?;
    tracked.iter().find(|(_, p)| is_displaced(start, *p)).map(|(_, p)| (*p - start).angle())
}

/// Compares squares, because a standing agent is compared with its whole past at each timestep.
fn is_displaced(from: Vec2, to: Vec2) -> bool {
    let Vec2 { x, y } = to - from;
    x * x + y * y >= MIN_DISPLACEMENT_M * MIN_DISPLACEMENT_M
}

fn velocity(tracked: &[(usize, Vec2)], timestamps_s: &[f64], i: usize, n_past: usize) -> Vec2 {
    let between = |from: usize, to: usize| {
        let ((t0, p0), (t1, p1)) = (tracked[from], tracked[to]);
        (p1 - p0) * (1.0 / (timestamps_s[t1] - timestamps_s[t0]))
    };
    let looks_ahead = i < n_past && i + 1 >= n_past;
    match i {
        0 if tracked.len() < 2 || looks_ahead => Vec2::ZERO,
        0 => between(0, 1),
        _ => between(i - 1, i),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn points(xy: &[Option<(f64, f64)>]) -> Vec<Option<Vec2>> {
        xy.iter().map(|p| p.map(|(x, y)| Vec2::new(x, y))).collect()
    }

    fn headings(states: &[Option<State>]) -> Vec<f64> {
        states.iter().flatten().map(|state| state.heading_rad).collect()
    }

    #[test]
    fn velocity_uses_the_time_that_passed() {
        let positions = points(&[Some((0.0, 0.0)), Some((2.0, 0.0)), None, Some((2.0, 6.0))]);
        let DerivedStates { states, .. } = derive_states(&positions, &[0.0, 0.1, 0.25, 0.4], 4);
        let velocities: Vec<Vec2> = states.iter().flatten().map(|state| state.velocity).collect();
        let expected = [Vec2::new(20.0, 0.0), Vec2::new(20.0, 0.0), Vec2::new(0.0, 20.0)];
        assert!(velocities.iter().zip(expected).all(|(v, e)| v.distance(e) < 1e-9), "{velocities:?}");
    }

    #[test]
    fn heading_is_that_of_the_last_meter_and_held_while_standing() {
        let positions =
            points(&[Some((0.0, 0.0)), Some((0.4, 0.0)), Some((2.0, 0.0)), Some((2.0, 0.3)), Some((2.0, 1.5))]);
        let DerivedStates { states, headings_from, .. } = derive_states(&positions, &[0.0, 0.1, 0.2, 0.3, 0.4], 5);
        let headings = headings(&states);
        assert_eq!(headings_from, 0);
        assert_eq!(headings[..3], [0.0, 0.0, 0.0]);
        assert!((headings[3] - 0.3f64.atan2(1.6)).abs() < 1e-12);
        assert!((headings[4] - FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn the_past_does_not_see_the_future() {
        // The track appears at the present (timestep 1), and its motion to the north is all in the future.
        let positions = points(&[None, Some((0.0, 0.0)), Some((0.0, 5.0)), Some((0.0, 10.0))]);
        let DerivedStates { states, headings_from, .. } = derive_states(&positions, &[0.0, 0.1, 0.2, 0.3], 2);
        let present = states[1].expect("tracked at present");
        assert_eq!((present.velocity, present.heading_rad), (Vec2::ZERO, 0.0));
        assert_eq!(headings_from, 2);
        assert!((states[2].expect("tracked").heading_rad - FRAC_PI_2).abs() < 1e-12);
        // Seen from a present at timestep 2, the first motion is known and gives the first heading.
        let DerivedStates { states, headings_from, .. } = derive_states(&positions, &[0.0, 0.1, 0.2, 0.3], 3);
        assert_eq!(headings_from, 0);
        assert!((states[1].expect("tracked").heading_rad - FRAC_PI_2).abs() < 1e-12);
        assert!(states[1].expect("tracked").velocity.distance(Vec2::new(0.0, 50.0)) < 1e-9);
    }

    #[test]
    fn what_stands_has_no_heading_of_its_own() {
        let DerivedStates { states, headings_from, .. } =
            derive_states(&points(&[Some((3.0, 3.0)); 4]), &[0.0, 0.1, 0.2, 0.3], 2);
        assert_eq!(headings_from, 4);
        assert_eq!(headings(&states), [0.0; 4]);
    }
}
