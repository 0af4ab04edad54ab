//! The kinematic reference of an agent: its observed states, interpolated and extrapolated.

use super::MotionCovariance;
use crate::geometry::{Transform2, Vec2, angle_difference, wrap_angle};
use crate::scene::{State, Track};

/// Position and heading by an agent's observed states alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ReferencePose {
    pub(super) position: Vec2,
    pub(super) heading_rad: f64,
}

/// The reference trajectory of one agent: its observed states, linear interpolation between them, and a continuation at
/// the velocity of the nearest observed state outside of them; after the present with the acceleration and the
/// curvature that the observed steps predict ([`Reference::continued`]).
pub(super) struct Reference<'a> {
    observed: Vec<(usize, &'a State)>,
    /// Place among the observed states of the last one up to the present, or of the first one after it.
    anchor: usize,
    /// The rotation of the agent's own frame.
    rotation: Transform2,
    dt_s: f64,
    /// Number of observed steps from which its motion after the last observed state is predicted.
    n_past: usize,
    /// The predicted additions at 1, 2, … timesteps after the last observed state: meters along and across its heading,
    /// and radians.
    added: Vec<[f64; 3]>,
}

impl<'a> Reference<'a> {
    /// The reference of `track`, given which of its timesteps are observed and which one is the present.
    pub(super) fn new(track: &'a Track, dt_s: f64, present: usize, observed: impl Fn(usize) -> bool) -> Self {
        let observed: Vec<(usize, &State)> =
            track.trajectory.valid().filter(|(timestep, _)| observed(*timestep)).collect();
        let anchor = observed.partition_point(|(timestep, _)| *timestep <= present).saturating_sub(1);
        let heading_rad = observed.get(anchor).map_or(0.0, |(_, state)| state.heading_rad);
        let rotation = Transform2::from_pose(Vec2::ZERO, heading_rad);
        Self { observed, anchor, rotation, dt_s, n_past: 0, added: Vec::new() }
    }

    /// The reference that continues from the present as `covariance` predicts from the steps up to it, without turning
    /// unless the agent `turns`. It is unchanged if something is observed later, or no step leads to the present.
    pub(super) fn continued(mut self, covariance: Option<&MotionCovariance>, turns: bool) -> Self {
        let Some(covariance) = covariance.filter(|_| self.anchor + 1 == self.observed.len()) else { return self };
        let are_consecutive = |pair: &&[(usize, &State)]| pair[0].0 + 1 == pair[1].0;
        let n_past = self.observed.windows(2).rev().take_while(are_consecutive).count().min(covariance.n_past);
        let Some(continuation) = covariance.continuation(n_past) else { return self };
        let steps: Vec<[f64; 3]> = self.observed_motion().map(|(_, step)| step).collect();
        let mut added = continuation.sums(&steps[steps.len() - n_past..]);
        if !turns {
            added.iter_mut().for_each(|sum| sum[2] = 0.0);
        }
        (self.n_past, self.added) = (n_past, added);
        self
    }

    /// Number of observed steps from which its motion after the last observed state is predicted; 0 if it is not.
    pub(super) const fn n_past(&self) -> usize {
        self.n_past
    }

    /// The heading of the agent's own frame: that of its last observed state up to the present, so that observing goals
    /// beside a history does not turn it, or otherwise of its first one; 0 for an agent never observed.
    pub(super) const fn frame_heading_rad(&self) -> f64 {
        self.rotation.rotation_rad()
    }

    /// The timestep of the state that the agent's own frame is taken from; 0 for an agent never observed.
    pub(super) fn anchor_timestep(&self) -> usize {
        self.observed.get(self.anchor).map_or(0, |(timestep, _)| *timestep)
    }

    /// Speed in that state, meters per second.
    pub(super) fn anchor_speed_mps(&self) -> f64 {
        self.observed.get(self.anchor).map_or(0.0, |(_, state)| state.velocity.norm())
    }

    /// The observed motion of an agent: for each observed timestep but the first, its motion from the previous observed
    /// state, per timestep, beyond that of constant velocity in its own frame: (longitudinal and lateral meters,
    /// radians).
    pub(super) fn observed_motion(&self) -> impl Iterator<Item = (usize, [f64; 3])> + '_ {
        let carried = self.observed.get(self.anchor).map_or(Vec2::ZERO, |(_, state)| state.velocity * self.dt_s);
        let own_from_scene = Transform2::from_pose(Vec2::ZERO, -self.frame_heading_rad());
        self.observed.windows(2).map(move |pair| {
            let [(t0, from), (t1, to)] = pair else { return (0, [0.0; 3]) };
            let n = (t1 - t0) as f64;
            let moved = own_from_scene.vector((to.position - from.position) * n.recip() - carried);
            (*t1, [moved.x, moved.y, angle_difference(to.heading_rad, from.heading_rad) / n])
        })
    }

    /// The reference at `timestep`; `None` for an agent never observed.
    pub(super) fn at(&self, timestep: usize) -> Option<ReferencePose> {
        let after = self.observed.partition_point(|(t, _)| *t < timestep);
        let carried = |(from, state): &(usize, &State)| {
            let elapsed_s = (timestep as f64 - *from as f64) * self.dt_s;
            ReferencePose { position: state.position + state.velocity * elapsed_s, heading_rad: state.heading_rad }
        };
        match (after.checked_sub(1).map(|i| &self.observed[i]), self.observed.get(after)) {
            (None, None) => None,
            (Some(before), None) => Some(self.predicted(carried(before), timestep - before.0)),
            (None, Some(next)) => Some(carried(next)),
            (Some((t0, s0)), Some((t1, s1))) => {
                let fraction = (timestep - t0) as f64 / (t1 - t0) as f64;
                let turn = angle_difference(s1.heading_rad, s0.heading_rad);
                Some(ReferencePose {
                    position: s0.position.lerp(s1.position, fraction),
                    heading_rad: wrap_angle(s0.heading_rad + turn * fraction),
                })
            }
        }
    }

    /// The pose `carried` on to `elapsed` timesteps after the last observed state, with the prediction added. Beyond
    /// its end the last step of the prediction is repeated.
    fn predicted(&self, carried: ReferencePose, elapsed: usize) -> ReferencePose {
        let (Some(last), Some(i)) = (self.added.len().checked_sub(1), elapsed.checked_sub(1)) else { return carried };
        let before = last.checked_sub(1).map_or([0.0; 3], |before| self.added[before]);
        let beyond = i.saturating_sub(last) as f64;
        let sum = |dim: usize| self.added[i.min(last)][dim] + beyond * (self.added[last][dim] - before[dim]);
        ReferencePose {
            position: carried.position + self.rotation.vector(Vec2::new(sum(0), sum(1))),
            heading_rad: wrap_angle(carried.heading_rad + sum(2)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::vehicle;

    fn track() -> Track {
        // Accelerates from 10 m/s by 1 m/s a step along x.
        let state = |t: usize| State {
            position: Vec2::new(t as f64 + 0.05 * (t * t) as f64, 0.0),
            heading_rad: 0.1 * t as f64,
            velocity: Vec2::new(10.0 + t as f64, 0.0),
        };
        Track { extent: None, ..vehicle("1", (0..8).map(|t| Some(state(t)))) }
    }

    #[test]
    fn carries_on_interpolates_and_passes_through() {
        let track = track();
        let reference = Reference::new(&track, 0.1, 3, |t| t == 2 || t == 4);
        let at = |t| reference.at(t).unwrap();
        assert!((at(4).position.x - (4.0 + 0.8)).abs() < 1e-12);
        assert!((at(3).position.x - (2.2 + 4.8) / 2.0).abs() < 1e-12 && (at(3).heading_rad - 0.3).abs() < 1e-12);
        assert!((at(6).position.x - (4.8 + 2.0 * 1.4)).abs() < 1e-12 && (at(6).heading_rad - 0.4).abs() < 1e-12);
        assert!((at(0).position.x - (2.2 - 2.0 * 1.2)).abs() < 1e-12);
        assert!((reference.frame_heading_rad() - 0.2).abs() < 1e-12);
        assert!(Reference::new(&track, 0.1, 3, |_| false).at(3).is_none());
    }

    #[test]
    fn observed_motion_is_what_constant_velocity_does_not_explain() {
        let track = track();
        let reference = Reference::new(&track, 0.1, 4, |t| t == 2 || t == 4 || t == 5);
        let motion: Vec<_> = reference.observed_motion().collect();
        // In the frame of timestep 4, which heads by 0.4 rad and moves by 1.4 m a timestep along the scene's x axis.
        for ((timestep, found), (expected_timestep, along_x)) in motion.iter().zip([(4, 1.3 - 1.4), (5, 1.45 - 1.4)]) {
            let expected = [along_x * 0.4f64.cos(), -along_x * 0.4f64.sin(), 0.1];
            assert_eq!(*timestep, expected_timestep);
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        }
        assert_eq!(motion.len(), 2);
        assert_eq!(Reference::new(&track, 0.1, 3, |t| t == 7).observed_motion().count(), 0);
    }

    #[test]
    fn acceleration_goes_on_where_it_was_observed() {
        // The covariance of traffic with constant accelerations, seen in three steps before the present.
        let step = |i: usize| i as f64 - 2.5;
        let values = (0..64).map(|at| step(at / 8) * step(at % 8)).collect();
        let covariance = MotionCovariance::new(3, 5, vec![values], vec![0.0]);
        let track = track();
        let continued = |observed: &dyn Fn(usize) -> bool| {
            Reference::new(&track, 0.1, 4, observed).continued(Some(&covariance), true)
        };
        // x is t + t²/20, and the heading at timestep 4 is 0.4 rad. The covariance has one dimension, so only the part
        // of the acceleration along that heading continues.
        let reference = continued(&|t| t <= 4);
        assert_eq!(reference.n_past(), 3);
        for (t, elapsed) in [(5, 1.0), (7, 3.0), (9, 5.0)] {
            let added =
                reference.at(t).unwrap().position - Reference::new(&track, 0.1, 4, |t| t <= 4).at(t).unwrap().position;
            let expected = 0.05 * elapsed * elapsed * 0.4f64.cos();
            assert!((added.norm() - expected).abs() < 1e-9, "{t}: {added:?}, expected {expected}");
        }
        // Beyond the covariance the last step is repeated.
        let far = reference.at(11).unwrap().position - reference.at(10).unwrap().position;
        let last = reference.at(9).unwrap().position - reference.at(8).unwrap().position;
        assert!(far.distance(last) < 1e-9);
        // A later observation, or a gap before the present: nothing is predicted.
        assert_eq!(continued(&|t| t <= 4 || t == 7).n_past(), 0);
        assert_eq!(continued(&|t| t <= 2 || t == 4).n_past(), 0);
        assert_eq!(continued(&|t| t == 1 || t == 3 || t == 4).n_past(), 1);
    }
}
