//! The motion of an agent around a timestep, by polynomials fitted to its positions.

use crate::geometry::{Vec2, unwrap_angles};
use crate::scene::{State, Trajectory};

/// The motion of an agent at the middle of a window of consecutive states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalFit {
    /// m/s, of the parabola fitted to the positions.
    pub velocity: Vec2,
    /// m/s², of the same parabola.
    pub acceleration: Vec2,
    /// m/s³, of the cubic fitted to the positions.
    pub jerk: Vec2,
    /// rad/s, of the line fitted to the headings.
    pub yaw_rate_radps: f64,
}

/// Least-squares fits over windows of an odd number of timesteps, at least five (Savitzky and Golay 1964).
#[derive(Debug, Clone, Copy)]
pub(super) struct Fitter {
    /// Timesteps on either side of the middle.
    pub(super) half: usize,
    dt_s: f64,
}

impl Fitter {
    /// Windows of at least `window_s`.
    pub(super) fn new(window_s: f64, dt_s: f64) -> Self {
        // An odd number of states, 2 h + 1, each of which stands for a timestep: 0.7 s at 10 Hz are seven.
        Self { half: (((window_s / dt_s - 1.0) / 2.0 - 1e-9).ceil() as usize).max(2), dt_s }
    }

    /// The fit around `middle`. `None` if the window has a state that is missing or not finite.
    pub(super) fn at(&self, trajectory: &Trajectory, middle: usize) -> Option<LocalFit> {
        let first = middle.checked_sub(self.half)?;
        let states: Vec<&State> = (first..=middle + self.half)
            .map(|timestep| trajectory.get(timestep).filter(|state| state.is_finite()))
            .collect::<Option<_>>()?;
        let mut headings: Vec<f64> = states.iter().map(|state| state.heading_rad).collect();
        unwrap_angles(&mut headings);
        // Sums of powers of the offsets -h..=h; odd ones vanish.
        let (mut n, mut s2, mut s4, mut s6) = (0.0, 0.0, 0.0, 0.0);
        let (mut p0, mut p1, mut p2, mut p3) = (Vec2::ZERO, Vec2::ZERO, Vec2::ZERO, Vec2::ZERO);
        let mut turned = 0.0;
        let origin = states[self.half].position;
        for (i, (state, heading_rad)) in states.iter().zip(&headings).enumerate() {
            let k = i as f64 - self.half as f64;
            let position = state.position - origin;
            (n, s2, s4, s6) = (n + 1.0, s2 + k * k, s4 + k.powi(4), s6 + k.powi(6));
            (p0, p1) = (p0 + position, p1 + position * k);
            (p2, p3) = (p2 + position * (k * k), p3 + position * k.powi(3));
            turned += heading_rad * k;
        }
        // Normal equations of a parabola and a cubic, whose even and odd parts separate.
        let curved = (p2 * n - p0 * s2) * (1.0 / (n * s4 - s2 * s2));
        let twisted = (p3 * s2 - p1 * s4) * (1.0 / (s2 * s6 - s4 * s4));
        let dt_s = self.dt_s;
        Some(LocalFit {
            velocity: p1 * (1.0 / (s2 * dt_s)),
            acceleration: curved * (2.0 / (dt_s * dt_s)),
            jerk: twisted * (6.0 / (dt_s * dt_s * dt_s)),
            yaw_rate_radps: turned / (s2 * dt_s),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_found_exactly() {
        let dt_s = 0.1;
        let fitter = Fitter::new(0.7, dt_s);
        assert_eq!(fitter.half, 3);
        let at = |cubic: f64| {
            let state = |i: i32| {
                let t = f64::from(i) * dt_s;
                let position = Vec2::new(3.0 + 4.0 * t + 1.5 * t * t + cubic * t * t * t, 7.0 - t * t);
                State { position, heading_rad: crate::geometry::wrap_angle(3.0 + 0.8 * t), velocity: Vec2::ZERO }
            };
            let trajectory = Trajectory::new((-3..=3).map(|i| Some(state(i))).collect());
            fitter.at(&trajectory, 3).expect("a whole window")
        };
        let fit = at(0.0);
        assert!(fit.velocity.distance(Vec2::new(4.0, 0.0)) < 1e-9);
        assert!(fit.acceleration.distance(Vec2::new(3.0, -2.0)) < 1e-9);
        assert!(fit.jerk.norm() < 1e-6 && (fit.yaw_rate_radps - 0.8).abs() < 1e-9);
        // A cubic term of 2 t³ is a jerk of 12; the parabola's acceleration does not see it, being odd.
        let fit = at(2.0);
        assert!(fit.jerk.distance(Vec2::new(12.0, 0.0)) < 1e-6);
        assert!(fit.acceleration.distance(Vec2::new(3.0, -2.0)) < 1e-9);
    }

    #[test]
    fn windows_are_whole() {
        let state = |timestep: usize| (timestep != 9).then_some(State::default());
        let trajectory = Trajectory::new((0..14).map(state).collect());
        let fitter = Fitter::new(0.7, 0.1);
        let whole: Vec<usize> = (0..14).filter(|middle| fitter.at(&trajectory, *middle).is_some()).collect();
        assert_eq!(whole, [3, 4, 5]);
        assert_eq!([Fitter::new(0.5, 0.1).half, Fitter::new(0.1, 0.1).half, Fitter::new(0.75, 0.1).half], [2, 2, 4]);
    }
}
