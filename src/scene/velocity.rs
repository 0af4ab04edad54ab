//! Velocities from positions, as in every table of states.

use super::{State, Trajectory};
use crate::geometry::Vec2;

/// The velocity at a timestep, meters per second: the slope there of the parabola through three consecutive positions,
/// centered if there are positions on both sides. `position(k)` is the position k timesteps later. Without a neighbor
/// there is no velocity.
///
/// The difference of two consecutive positions would be the velocity half a timestep earlier or later. That of three is
/// exact at constant acceleration: at the end of a track it is (3 x(t) - 4 x(t - 1) + x(t - 2)) / 2 Δt.
pub fn velocity_at(position: impl Fn(isize) -> Option<Vec2>, dt_s: f64) -> Option<Vec2> {
    let step = |from: isize| position(from).zip(position(from + 1)).map(|(before, after)| after - before);
    let moved = match (step(-1), step(0)) {
        (Some(came), Some(goes)) => (came + goes) * 0.5,
        (Some(came), None) => step(-2).map_or(came, |earlier| came + (came - earlier) * 0.5),
        (None, Some(goes)) => step(1).map_or(goes, |later| goes - (later - goes) * 0.5),
        (None, None) => return None,
    };
    Some(moved * (1.0 / dt_s))
}

impl Trajectory {
    /// The trajectory with velocities derived from its positions ([`velocity_at`]). The first `n_history` timesteps are
    /// the past, whose velocities follow from the past alone. A state without a neighbor keeps its velocity.
    #[must_use]
    pub fn with_velocities_from_positions(&self, n_history: usize, dt_s: f64) -> Self {
        let velocity = |timestep: usize, state: &State| {
            let end = if timestep < n_history { n_history } else { self.n_timesteps() };
            let position = |offset: isize| {
                let at = timestep.checked_add_signed(offset).filter(|at| *at < end)?;
                self.get(at).map(|state| state.position)
            };
            velocity_at(position, dt_s).unwrap_or(state.velocity)
        };
        let entries = self.entries().iter().enumerate();
        self.with_states(
            entries.map(|(t, state)| state.map(|state| State { velocity: velocity(t, &state), ..state })).collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// x = 3 t + 2 t² and y = t³ at 10 Hz, with velocity columns of their own.
    fn state(timestep: usize) -> State {
        let t_s = 0.1 * timestep as f64;
        let position = Vec2::new(3.0 * t_s + 2.0 * t_s.powi(2), t_s.powi(3));
        State { position, velocity: Vec2::new(-7.0, 7.0), ..State::default() }
    }

    fn velocities(is_valid: impl Fn(usize) -> bool, n_history: usize) -> Vec<Option<Vec2>> {
        let states = (0..8).map(|timestep| is_valid(timestep).then(|| state(timestep))).collect();
        let derived = Trajectory::new(states).with_velocities_from_positions(n_history, 0.1);
        derived.entries().iter().map(|state| state.map(|state| state.velocity)).collect()
    }

    #[test]
    fn they_are_exact_at_constant_acceleration() {
        for (timestep, found) in velocities(|_| true, 4).into_iter().enumerate() {
            let expected_x = 3.0 + 0.4 * timestep as f64;
            assert!((found.unwrap().x - expected_x).abs() < 1e-12, "{timestep}: {found:?}");
        }
    }

    #[test]
    fn the_past_does_not_see_the_future() {
        // y(t) = t³: the backward difference at the present (timestep 3) is (3 * 27 - 4 * 8 + 1) * 1e-3 / 0.2.
        let found = velocities(|_| true, 4);
        assert!((found[3].unwrap().y - 0.25).abs() < 1e-12, "{found:?}");
        // After it, and in the future, the difference is centered.
        assert!((found[2].unwrap().y - 0.13).abs() < 1e-12 && (found[4].unwrap().y - 0.49).abs() < 1e-12, "{found:?}");
        let other = velocities(|timestep| timestep != 4, 4);
        assert_eq!(found[..4], other[..4]);
    }

    #[test]
    fn a_state_without_neighbors_keeps_what_was_recorded() {
        // First seen at the present, timestep 3; alone at 5.
        let found = velocities(|timestep| matches!(timestep, 3 | 5), 4);
        assert_eq!([found[3], found[5]], [Some(Vec2::new(-7.0, 7.0)); 2]);
        // Two states: their difference.
        let found = velocities(|timestep| matches!(timestep, 2 | 3), 4);
        assert!((found[2].unwrap().x - 4.0).abs() < 1e-12 && found[2] == found[3], "{found:?}");
    }
}
