//! Courses between and beyond recorded states, and the states of changed courses.

use super::{Scene, State, Trajectory, velocity_at};
use crate::geometry::{Polyline, Vec2, angle_difference, wrap_angle};

/// A step shorter than this does not define a heading, meters.
pub const STANDING_STEP_M: f64 = 0.05;

/// A recorded course as a function of continuous time: linear between states, at constant velocity beyond them.
pub(super) struct Motion<'a> {
    states: Vec<(usize, &'a State)>,
    dt_s: f64,
}

impl<'a> Motion<'a> {
    /// The course of a track with at least one state.
    pub(super) fn new(trajectory: &'a Trajectory, dt_s: f64) -> Option<Self> {
        let states: Vec<(usize, &State)> = trajectory.valid().collect();
        (!states.is_empty()).then_some(Self { states, dt_s })
    }

    pub(super) fn at(&self, time: f64) -> State {
        let after = self.states.partition_point(|(timestep, _)| (*timestep as f64) < time);
        let carried = |(timestep, state): (usize, &State)| State {
            position: state.position + state.velocity * ((time - timestep as f64) * self.dt_s),
            ..*state
        };
        match (after.checked_sub(1).map(|i| self.states[i]), self.states.get(after).copied()) {
            (Some(before), None) => carried(before),
            (None, Some(next)) => carried(next),
            (Some((t0, s0)), Some((t1, s1))) => {
                let share = (time - t0 as f64) / (t1 - t0) as f64;
                State {
                    position: s0.position.lerp(s1.position, share),
                    heading_rad: wrap_angle(s0.heading_rad + angle_difference(s1.heading_rad, s0.heading_rad) * share),
                    velocity: s0.velocity.lerp(s1.velocity, share),
                }
            }
            // There is at least one state.
            (None, None) => State::default(),
        }
    }
}

/// 0 before `start`, 1 from `end` on, and a smooth 3 u² - 2 u³ between.
pub(super) fn smooth_step(time: f64, start: f64, end: f64) -> f64 {
    if time >= end {
        return 1.0;
    }
    let share = ((time - start) / (end - start)).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

/// The point `station_m` along the line, which continues straight beyond its end in direction `end_heading_rad`.
pub(super) fn point_along(line: &Polyline, station_m: f64, end_heading_rad: f64) -> Option<Vec2> {
    let beyond_m = (station_m - line.length_m()).max(0.0);
    Some(line.point_at(station_m)? + Vec2::from_angle(end_heading_rad) * beyond_m)
}

/// The point at time `u` in [0, 1] between two points with these tangents (derivatives by `u`): a cubic Hermite curve.
pub(super) fn hermite(from: (Vec2, Vec2), to: (Vec2, Vec2), u: f64) -> Vec2 {
    let (u2, u3) = (u * u, u * u * u);
    from.0 * (2.0 * u3 - 3.0 * u2 + 1.0)
        + from.1 * (u3 - 2.0 * u2 + u)
        + to.0 * (3.0 * u2 - 2.0 * u3)
        + to.1 * (u3 - u2)
}

/// Replaces the future of an agent by a course through `positions`, one for each timestep after the present. Velocities
/// are slopes of the positions; headings follow the direction of motion, and are held while the agent stands.
pub(super) fn with_future(scene: &mut Scene, agent_idx: usize, positions: &[Vec2]) {
    let present = scene.current_timestep();
    let old = scene.tracks[agent_idx].trajectory.clone();
    let mut entries: Vec<Option<State>> = old.entries().to_vec();
    let Some(motion) = Motion::new(&old, scene.dt_s) else { return };
    for (timestep, position) in (present + 1..scene.n_timesteps).zip(positions) {
        let before = entries[timestep - 1].unwrap_or_else(|| motion.at(timestep as f64 - 1.0));
        let step = *position - before.position;
        let (recorded, recorded_before) = (motion.at(timestep as f64), motion.at(timestep as f64 - 1.0));
        let recorded_step = recorded.position - recorded_before.position;
        let heading_rad = if step.norm() < STANDING_STEP_M {
            before.heading_rad
        } else if recorded_step.norm() < STANDING_STEP_M {
            step.angle()
        } else {
            wrap_angle(recorded.heading_rad + angle_difference(step.angle(), recorded_step.angle()))
        };
        entries[timestep] = Some(State { position: *position, heading_rad, velocity: Vec2::ZERO });
    }
    let positions: Vec<Option<Vec2>> = entries.iter().map(|entry| entry.map(|state| state.position)).collect();
    for (timestep, entry) in entries.iter_mut().enumerate().skip(present + 1) {
        let position = |offset: isize| positions.get(timestep.checked_add_signed(offset)?).copied().flatten();
        if let Some(state) = entry {
            state.velocity = velocity_at(position, scene.dt_s).unwrap_or_default();
        }
    }
    scene.tracks[agent_idx].trajectory = Trajectory::new(entries);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene, without_states};

    #[test]
    fn courses_are_interpolated_and_carried_on() {
        // 10 m/s at 10 Hz: one meter a timestep; no states at 5 and 6, nor after 9.
        let scene = without_states(scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]), 0, |t| t == 5 || t == 6 || t > 9);
        let motion = Motion::new(&scene.tracks[0].trajectory, scene.dt_s).unwrap();
        for time in [-2.0, 0.0, 3.25, 5.5, 9.0, 14.5] {
            assert!((motion.at(time).position.x - time).abs() < 1e-12, "{time}");
        }
        assert!(Motion::new(&Trajectory::new(vec![None; 3]), 0.1).is_none());
    }

    #[test]
    fn the_smooth_step_has_its_ends_and_middle() {
        assert_eq!([0.0, 2.0, 3.0, 4.0, 9.0].map(|t| smooth_step(t, 2.0, 4.0)), [0.0, 0.0, 0.5, 1.0, 1.0]);
        assert_eq!(smooth_step(2.0, 2.0, 2.0), 1.0);
        // A quarter of the way: 3/16 - 2/64 = 10/64.
        assert!((smooth_step(2.5, 2.0, 4.0) - 0.15625).abs() < 1e-15);
    }

    #[test]
    fn a_hermite_curve_of_a_parabola_is_the_parabola() {
        // (u, u²): tangents (1, 0) and (1, 2).
        let curve = |u: f64| hermite((Vec2::ZERO, Vec2::new(1.0, 0.0)), (Vec2::new(1.0, 1.0), Vec2::new(1.0, 2.0)), u);
        for u in [0.0, 0.3, 0.5, 1.0] {
            assert!(curve(u).distance(Vec2::new(u, u * u)) < 1e-12);
        }
    }

    #[test]
    fn a_changed_course_turns_headings_and_keeps_the_past() {
        let original = scene(&[Drive::straight(0.0, 0.0, 0.5, 10.0)]);
        let mut turned = original.clone();
        let now = original.state(0, 3).unwrap().position;
        let positions: Vec<Vec2> = (1..9).map(|i| now + Vec2::from_angle(0.8) * (0.5 * f64::from(i))).collect();
        with_future(&mut turned, 0, &positions);
        assert_eq!(turned.tracks[0].trajectory.entries()[..4], original.tracks[0].trajectory.entries()[..4]);
        for t in 4..12 {
            let state = turned.state(0, t).unwrap();
            assert!((state.heading_rad - 0.8).abs() < 1e-9 && (state.speed_mps() - 5.0).abs() < 1e-9);
        }
        with_future(&mut turned, 0, &[now; 8]);
        assert!((turned.state(0, 11).unwrap().heading_rad - 0.5).abs() < 1e-12, "who stands keeps its heading");
    }
}
