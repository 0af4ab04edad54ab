//! Errors of observed states, which are estimated and removed before a scene is encoded.
//!
//! Trackers differ in their errors by orders of magnitude. A prediction that takes 10 cm of error for acceleration is
//! meters off after 3 s, and a network that was trained on exact pasts has never seen the like. So each track is
//! replaced by the likeliest motion of traffic, given its observations: with p = E e + q for the observed steps p,
//! errors e of the positions and true steps q of covariance C, the errors are expected to be s² Eᵀ (C + s² E Eᵀ)⁻¹ p.
//! Their size s is the one under which p is likeliest. A track is left as it is if that is the least size, also if its
//! motion is a few times as lively as most: a vehicle that turns into a roundabout moves far, but smoothly.

use super::continuation::{MIN_SHARE_OF_NOISE, grid, inverse, product};
use super::reference::{Reference, ReferencePose};
use super::{MotionCovariance, SceneView};
use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{Scene, State, Track, Trajectory};
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

/// Possible explanations of a track: how lively its motion is and how large its errors are, as multiples of the
/// ordinary standard deviation and of the least errors. In the first few, the track is exact.
const EXPLANATIONS: [[f64; 2]; 7] =
    [[1.0, 1.0], [2.0, 1.0], [4.0, 1.0], [1.0, 4.0], [1.0, 16.0], [1.0, 64.0], [1.0, 256.0]];
const N_EXACT: usize = 3;
/// The time in which errors fade after the present to a third, seconds.
const FADE_S: f64 = 0.4;
/// Fewer observed steps do not tell errors from motion.
const MIN_STEPS: usize = 4;

/// The estimate of one dimension's errors from k observed steps by one explanation, with motion of covariance C.
#[derive(Debug, Clone)]
struct Estimate {
    /// (C + s² E Eᵀ)⁻¹: k x k.
    precision: Vec<f64>,
    /// ln det (C + s² E Eᵀ).
    log_determinant: f64,
    /// s² Eᵀ (C + s² E Eᵀ)⁻¹: (k + 1) x k.
    errors: Vec<f64>,
}

/// The estimates of a covariance by dimension, number of observed steps and explanation, made when they are first
/// needed.
#[derive(Debug, Clone, Default)]
pub(super) struct Estimates(Arc<OnceLock<Vec<Estimate>>>);

impl PartialEq for Estimates {
    /// They follow from the covariance.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl MotionCovariance {
    /// The errors in dimension `dim` of the positions (or headings) between which the observed `steps` lie, in units of
    /// x; `None` if they are as exact as those of training traffic.
    fn errors(&self, dim: usize, steps: &[f64]) -> Option<Vec<f64>> {
        let k = steps.len();
        let all = || {
            let of_dim = |dim| (MIN_STEPS..=self.n_past).map(move |k| (dim, k));
            let cases = (0..self.noise.len()).flat_map(of_dim);
            cases.flat_map(|(dim, k)| EXPLANATIONS.map(|explanation| self.estimate(dim, k, explanation))).collect()
        };
        if !(MIN_STEPS..=self.n_past).contains(&k) || self.noise.get(dim).is_none_or(|noise| *noise <= 0.0) {
            return None;
        }
        let first = (dim * (self.n_past + 1 - MIN_STEPS) + k - MIN_STEPS) * EXPLANATIONS.len();
        let estimates = &self.estimates.0.get_or_init(all)[first..first + EXPLANATIONS.len()];
        let of_steps = |matrix: &[f64]| product(matrix, steps, k, 1);
        let log_likelihood = |estimate: &Estimate| {
            let weighted = of_steps(&estimate.precision);
            -0.5 * (weighted.iter().zip(steps).map(|(a, b)| a * b).sum::<f64>() + estimate.log_determinant)
        };
        let mut best = (0, f64::NEG_INFINITY);
        for (place, likelihood) in estimates.iter().map(log_likelihood).enumerate() {
            // The first among equal ones.
            best = if likelihood > best.1 { (place, likelihood) } else { best };
        }
        (best.0 >= N_EXACT).then(|| of_steps(&estimates[best.0].errors))
    }

    fn estimate(&self, dim: usize, k: usize, [liveliness, size]: [f64; 2]) -> Estimate {
        let (first, n) = (self.n_past - k, self.n_past + self.n_timesteps);
        let variance = (self.noise[dim] * size).powi(2);
        let e = grid(k, k + 1, |i, position| self.share_of_error(dim, first + i, first + position));
        let transposed = grid(k + 1, k, |position, i| e[i * (k + 1) + position]);
        let of_errors = product(&e, &transposed, k + 1, k);
        let c = |i: usize, j: usize| liveliness * liveliness * self.values[dim][(first + i) * n + first + j];
        let of_steps = grid(k, k, |i, j| c(i, j) + variance * of_errors[i * k + j]);
        let (precision, log_determinant) = inverse(of_steps, k, MIN_SHARE_OF_NOISE * self.noise[dim].powi(2));
        let errors = product(&transposed, &precision, k, k).into_iter().map(|value| value * variance).collect();
        Estimate { precision, log_determinant, errors }
    }
}

/// The scene of `view` with the observed states before and at the present as they are likeliest to have been.
/// `motion_units` are meters along and across and radians by unit of x.
pub(super) fn without_errors<'a>(
    view: &SceneView<'a>,
    covariance: &MotionCovariance,
    motion_units: [f64; 3],
) -> Cow<'a, Scene> {
    let mut scene = Cow::Borrowed(view.scene);
    for (idx, track) in view.scene.tracks.iter().enumerate() {
        let observed = |timestep: usize| timestep < view.mask.n_timesteps() && view.mask.is_observed(idx, timestep);
        let believed = track_without_errors(track, view.scene, observed, covariance, motion_units);
        if let Some(trajectory) = believed {
            scene.to_mut().tracks[idx].trajectory = trajectory;
        }
    }
    scene
}

/// The trajectory of `track` in the scene frame without the errors of its states up to the present; as many of them as
/// the covariance covers are `observed`. `None` if it is exact, or too little of it was observed.
fn track_without_errors(
    track: &Track,
    scene: &Scene,
    observed: impl Fn(usize) -> bool,
    covariance: &MotionCovariance,
    motion_units: [f64; 3],
) -> Option<Trajectory> {
    let present = scene.current_timestep();
    let is_known = |timestep: &usize| observed(*timestep) && track.trajectory.is_valid(*timestep);
    let n_steps = (0..=present).rev().take_while(is_known).count().checked_sub(1)?.min(covariance.n_past);
    let reference = Reference::new(track, scene.dt_s, present, |timestep| timestep <= present && observed(timestep));
    let steps: Vec<[f64; 3]> = reference.observed_motion().map(|(_, step)| step).collect();
    let steps = &steps[steps.len().checked_sub(n_steps)?..];
    let errors_of = |dim: usize| {
        let in_units: Vec<f64> = steps.iter().map(|step| step[dim] / motion_units[dim]).collect();
        let errors = covariance.errors(dim, &in_units)?;
        Some(errors.into_iter().map(|error| error * motion_units[dim]).collect::<Vec<f64>>())
    };
    let errors = [errors_of(0), errors_of(1), errors_of(2).filter(|_| track.class.has_recorded_heading())];
    if errors.iter().all(Option::is_none) {
        return None;
    }
    let error = |dim: usize, i: usize| errors[dim].as_ref().map_or(0.0, |errors| errors[i]);
    let offset = |i: usize| Vec2::new(error(0, i), error(1, i)).rotated(reference.frame_heading_rad());
    // The slope at the last of the positions up to each, as velocities follow from them.
    let slope = |i: usize| match i {
        0 | 1 => offset(1) - offset(0),
        _ => offset(i) * 1.5 - offset(i - 1) * 2.0 + offset(i - 2) * 0.5,
    };
    let believed = |(timestep, state): (usize, &Option<State>)| {
        let state = (*state)?;
        let i = (timestep + n_steps).checked_sub(present).filter(|i| *i <= n_steps);
        let Some(i) = i else { return Some(state) };
        Some(State {
            position: state.position - offset(i),
            heading_rad: wrap_angle(state.heading_rad - error(2, i)),
            velocity: state.velocity - slope(i) * scene.dt_s.recip(),
        })
    };
    Some(Trajectory::new(track.trajectory.entries().iter().enumerate().map(believed).collect()))
}

/// Errors that were taken from a track, which fade after the present.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FadingErrors {
    present: usize,
    dt_s: f64,
    /// Meters in the scene frame at present, …
    position: Vec2,
    /// … meters per second, and radians.
    velocity: Vec2,
    heading_rad: f64,
}

impl FadingErrors {
    /// The difference at present between a `recorded` track and its `believed` one; `None` if there is none.
    pub(super) fn between(scene: &Scene, recorded: &Track, believed: &Track) -> Option<Self> {
        let (present, dt_s) = (scene.current_timestep(), scene.dt_s);
        let (recorded, believed) = (recorded.trajectory.get(present)?, believed.trajectory.get(present)?);
        (recorded != believed).then(|| Self {
            present,
            dt_s,
            position: recorded.position - believed.position,
            velocity: recorded.velocity - believed.velocity,
            heading_rad: angle_difference(recorded.heading_rad, believed.heading_rad),
        })
    }

    /// The pose with the remaining errors at `timestep`: they begin with their own velocity and decay.
    pub(super) fn added_to(&self, pose: ReferencePose, timestep: usize) -> ReferencePose {
        let Some(elapsed) = timestep.checked_sub(self.present).filter(|elapsed| *elapsed > 0) else { return pose };
        let elapsed_s = elapsed as f64 * self.dt_s;
        let left = (-elapsed_s / FADE_S).exp();
        let position = self.position + (self.velocity + self.position * FADE_S.recip()) * elapsed_s;
        ReferencePose {
            position: pose.position + position * left,
            heading_rad: wrap_angle(pose.heading_rad + self.heading_rad * left),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::continuation::tests::wandering;
    use super::super::testing::collator;
    use super::super::{FutureValidity, StateParametrization};
    use super::*;
    use crate::scene::ObservationMask;
    use crate::scene::testing::{Drive, scene};

    /// The steps beyond the velocity at the present of an agent seen at `positions`.
    fn steps(positions: &[f64]) -> Vec<f64> {
        let n = positions.len();
        let velocity = 1.5 * positions[n - 1] - 2.0 * positions[n - 2] + 0.5 * positions[n - 3];
        positions.windows(2).map(|pair| pair[1] - pair[0] - velocity).collect()
    }

    #[test]
    fn exact_motion_stays_as_it_is() {
        let braking: Vec<f64> = (0..10).map(|t| f64::from(t) - 0.005 * f64::from(t * t)).collect();
        assert_eq!(wandering(9, 30).errors(0, &steps(&braking)), None);
        assert_eq!(wandering(9, 30).errors(0, &[0.0; 9]), None);
        assert_eq!(wandering(9, 30).errors(0, &[0.3, -0.3]), None, "too few to tell");
    }

    #[test]
    fn who_moves_more_than_others_is_believed() {
        // Turns and brakes three times as hard as one in a hundred does, but smoothly.
        let lively: Vec<f64> = (0..10).map(|t| f64::from(t) + 2.0 * (f64::from(t) / 6.0).cos()).collect();
        assert_eq!(wandering(9, 30).errors(0, &steps(&lively)), None);
    }

    #[test]
    fn samples_begin_where_the_recording_ends() {
        let fading = FadingErrors {
            present: 9,
            dt_s: 0.1,
            position: Vec2::new(0.2, -0.1),
            velocity: Vec2::new(0.5, 0.3),
            heading_rad: 0.1,
        };
        let pose = ReferencePose { position: Vec2::new(5.0, 5.0), heading_rad: 1.0 };
        assert_eq!(fading.added_to(pose, 9), pose, "what is observed stays");
        // The offset and its slope at the present are those of the errors.
        let soon = FadingErrors { dt_s: 1e-5, ..fading }.added_to(pose, 10);
        let offset = soon.position - pose.position - fading.position;
        assert!((offset * 1e5 - fading.velocity).norm() < 1e-3, "{offset:?}");
        assert!((soon.heading_rad - 1.1).abs() < 1e-4);
        let late = fading.added_to(pose, 39);
        assert!(late.position.distance(pose.position) < 5e-3 && (late.heading_rad - 1.0).abs() < 1e-3, "{late:?}");
    }

    #[test]
    fn errors_fade_before_a_wanted_state_and_not_in_it() {
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0, 4.0, 0.0, 8.0)]);
        (scene.n_history, scene.n_timesteps) = (8, 12);
        let noisy = |(t, state): (usize, &Option<State>)| {
            let error = if t < 8 { [0.1, -0.1][t % 2] } else { 0.0 };
            state.map(|state| State { position: state.position + Vec2::new(error, -error), ..state })
        };
        let track = &mut scene.tracks[1].trajectory;
        *track = Trajectory::new(track.entries().iter().enumerate().map(noisy).collect())
            .with_velocities_from_positions(8, scene.dt_s);
        let mut collator = collator([&scene], StateParametrization::Motion);
        let values = wandering(7, 4).values.remove(0);
        collator.normalizer.motion_covariance = Some(MotionCovariance::new(7, 4, vec![values; 3], vec![1e-3; 3]));
        let mask = ObservationMask::from_fn(2, 12, |_, timestep| timestep < 8 || timestep == 11);
        let base = |validity| -> Vec<Vec<f32>> {
            collator.masked(&scene, &mask, validity).base.get(0).unwrap().get(1).unwrap().to_vec2().unwrap()
        };
        let (sampled, trained) = (base(FutureValidity::Everything), base(FutureValidity::Recorded));
        assert_eq!(sampled[11], trained[11]);
        assert!((sampled[8][0] - trained[8][0]).abs() > 1e-3, "{:?} {:?}", sampled[8], trained[8]);
    }

    #[test]
    fn errors_are_found() {
        // Constant speed, observed with errors of 10 cm. A shift of all positions is not observable; these errors have
        // none.
        let errors = [0.08, -0.12, 0.05, 0.11, -0.09, -0.03, 0.14, -0.1, 0.03, -0.07];
        let noisy: Vec<f64> = (0..).map(f64::from).zip(errors).map(|(t, error)| t + error).collect();
        let found = wandering(9, 30).errors(0, &steps(&noisy)).unwrap();
        let left: f64 = found.iter().zip(errors).map(|(found, error)| (found - error).powi(2)).sum();
        assert!((left / 10.0).sqrt() < 0.06, "{found:?}");
        // They are the errors under which the remaining steps are those of smooth motion.
        let believed: Vec<f64> = noisy.iter().zip(&found).map(|(position, error)| position - error).collect();
        assert_eq!(wandering(9, 30).errors(0, &steps(&believed)), None);
        assert!(found.iter().sum::<f64>().abs() < 1e-9, "{found:?}");
    }
}
