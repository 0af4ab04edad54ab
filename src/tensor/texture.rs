//! The roughness of an agent's motion, estimated from its observed steps.
//!
//! Trackers and drivers give motion a texture whose size differs from agent to agent by an order of magnitude within
//! one dataset. The covariance of motion is that of the average agent. With the observed steps p in their modes, the
//! roughness is the mean of their squares over their variances in the upper half of the modes, r = mean (u·p)² / λ; and
//! the variances of the later motion are, in the modes of fast motion, c rᵝ times those of the average agent.

use super::MotionCovariance;
use super::continuation::{MIN_SHARE_OF_NOISE, grid};
use super::eigen::{Eigen, symmetric_eigen};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};

/// The modes of fast motion are all but this share of the slowest: those above about 1 Hz of 3 s.
const SLOW_SHARE: f64 = 0.2;
/// Roughness is limited to this range: standing agents are rougher than measured, and jumps are errors.
const ROUGHNESS: [f64; 2] = [0.01, 100.0];
/// The variances of an agent differ from the average at most by factors in this range.
const FACTORS: [f64; 2] = [0.01, 100.0];
/// Fewer tracks do not show how roughness continues.
const MIN_TRACKS: usize = 100;
/// The share of tracks that count for the mean; the others jump.
const KEPT_SHARE: f64 = 0.99;

/// The relation of the roughness of motion to that of the observed steps in one dimension.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Texture {
    /// β.
    pub exponent: f64,
    /// c.
    pub factor: f64,
}

impl Texture {
    /// Motion that is as rough as that of the average agent.
    pub(super) const AVERAGE: Self = Self { exponent: 0.0, factor: 1.0 };
}

/// The modes of the observed steps by dimension, made when they are first needed.
#[derive(Debug, Clone, Default)]
pub(super) struct ModesOfPast(Arc<OnceLock<Vec<Eigen>>>);

impl PartialEq for ModesOfPast {
    /// They follow from the covariance.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Whether the `i`-th of `n` modes, the slowest first, is one of fast motion.
pub(super) fn is_fast(i: usize, n: usize) -> bool {
    i as f64 >= SLOW_SHARE * n as f64
}

/// The mean square, relative to their variances, of the numbers `values` in the modes that `counts` accepts, the mode
/// of the largest variance first; `None` if there is none with a variance above `least`.
fn roughness(eigen: &Eigen, values: &[f64], counts: impl Fn(usize) -> bool, least: f64) -> Option<f64> {
    let n = values.len();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| eigen.values[*b].total_cmp(&eigen.values[*a]));
    let modes = order.iter().enumerate().filter(|(rank, _)| counts(*rank)).map(|(_, mode)| *mode);
    let squares: Vec<f64> = modes
        .filter(|mode| eigen.values[*mode] > least)
        .map(|mode| {
            let along: f64 = eigen.vectors[mode * n..(mode + 1) * n].iter().zip(values).map(|(u, p)| u * p).sum();
            along * along / eigen.values[mode]
        })
        .collect();
    (!squares.is_empty()).then(|| squares.iter().sum::<f64>() / squares.len() as f64)
}

impl MotionCovariance {
    /// The factor of the variances of fast motion in dimension `dim` of an agent that was observed in all K `steps`, in
    /// units of x; 1 if they are fewer.
    pub(super) fn texture_factor(&self, dim: usize, steps: &[f64]) -> f64 {
        let Some(texture) = self.texture.get(dim).filter(|_| steps.len() == self.n_past) else { return 1.0 };
        let roughness = self.roughness_of_past(dim, steps);
        roughness.map_or(1.0, |r| (texture.factor * r.powf(texture.exponent)).clamp(FACTORS[0], FACTORS[1]))
    }

    fn roughness_of_past(&self, dim: usize, steps: &[f64]) -> Option<f64> {
        let size = self.n_past + self.n_timesteps;
        let of_dim = |values: &Vec<f64>| {
            symmetric_eigen(grid(self.n_past, self.n_past, |i, j| values[i * size + j]), self.n_past)
        };
        let modes = &self.modes_of_past.0.get_or_init(|| self.values.iter().map(of_dim).collect())[dim];
        let least = MIN_SHARE_OF_NOISE * self.noise.get(dim).map_or(0.0, |noise| noise * noise);
        let found = roughness(modes, steps, |rank| rank >= self.n_past / 2, least)?;
        Some(found.clamp(ROUGHNESS[0], ROUGHNESS[1]))
    }

    /// The texture of `tracks` of training traffic in dimension `dim`: observed steps and the motion after them, in
    /// units of x. `None` if they are too few.
    pub(super) fn fit_texture(&self, dim: usize, tracks: &[(Vec<f64>, Vec<f64>)]) -> Option<Texture> {
        let continuation = self.continuation(self.n_past)?;
        let rest = symmetric_eigen(continuation.covariance[dim].clone(), self.n_timesteps);
        let logs: Vec<[f64; 2]> = tracks
            .iter()
            .filter_map(|(past, future)| {
                let before = self.roughness_of_past(dim, past).filter(|r| *r > ROUGHNESS[0] && *r < ROUGHNESS[1])?;
                let beyond = continuation.beyond(dim, past, future);
                let after = roughness(&rest, &beyond, |rank| is_fast(rank, self.n_timesteps), 0.0)?;
                (after > 0.0).then(|| [before.ln(), after.ln()])
            })
            .collect();
        if logs.len() < MIN_TRACKS {
            return None;
        }
        let n = logs.len() as f64;
        let means: [f64; 2] = std::array::from_fn(|i| logs.iter().map(|log| log[i]).sum::<f64>() / n);
        let product =
            |i: usize, j: usize| logs.iter().map(|log| (log[i] - means[i]) * (log[j] - means[j])).sum::<f64>();
        let exponent = (product(0, 1) / product(0, 0).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let mut ratios: Vec<f64> = logs.iter().map(|[before, after]| (after - exponent * before).exp()).collect();
        ratios.sort_by(f64::total_cmp);
        ratios.truncate((KEPT_SHARE * n).ceil() as usize);
        let factor = ratios.iter().sum::<f64>() / ratios.len() as f64;
        Some(Texture { exponent, factor })
    }
}

#[cfg(test)]
mod tests {
    use super::super::StateParametrization;
    use super::super::sight::Sight;
    use super::super::testing::collator;
    use super::*;
    use crate::geometry::Vec2;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{Scene, State, Trajectory};
    use crate::seed::{Seed, SeededRng};

    /// Independent steps and motion of unit variance: six observed, ten after them.
    fn white() -> MotionCovariance {
        let values = grid(16, 16, |i, j| f64::from(u8::from(i == j)));
        MotionCovariance::new(6, 10, vec![values], vec![0.0])
    }

    /// Tracks that are up to `spread` times as rough as others.
    fn tracks(spread: f64, n: usize) -> Vec<(Vec<f64>, Vec<f64>)> {
        let mut rng = Seed(3).rng();
        let draw = |rng: &mut SeededRng, n: usize, size: f64| (0..n).map(|_| size * rng.normal()).collect::<Vec<f64>>();
        let track = |i: usize| {
            let size = spread.powf(i as f64 / n as f64 - 0.5);
            (draw(&mut rng, 6, size), draw(&mut rng, 10, size))
        };
        (0..n).map(track).collect()
    }

    #[test]
    fn roughness_is_the_mean_square_in_the_fast_modes() {
        // Modes of variance 9, 4 and 1 along the axes; of the last two, 16 / 4 and 1 / 1.
        let eigen = Eigen { values: vec![4.0, 9.0, 1.0], vectors: grid(3, 3, |i, j| f64::from(u8::from(i == j))) };
        assert_eq!(roughness(&eigen, &[4.0, 30.0, 1.0], |rank| rank > 0, 0.0), Some(2.5));
        assert_eq!(roughness(&eigen, &[4.0, 30.0, 1.0], |rank| rank > 0, 2.0), Some(4.0));
        assert_eq!(roughness(&eigen, &[4.0, 30.0, 1.0], |_| true, 10.0), None);
        assert_eq!([1, 2, 9].map(|i| is_fast(i, 10)), [false, true, true]);
    }

    #[test]
    fn who_was_rough_stays_rough_if_traffic_does() {
        let covariance = white();
        let alike = covariance.fit_texture(0, &tracks(1.0, 3000)).unwrap();
        assert!(alike.exponent.abs() < 0.05 && (alike.factor - 1.0).abs() < 0.05, "{alike:?}");
        let spread = covariance.fit_texture(0, &tracks(10.0, 3000)).unwrap();
        assert!(spread.exponent > 0.3, "{spread:?}");
        assert!(covariance.fit_texture(0, &tracks(1.0, 99)).is_none(), "too few");
        let known = MotionCovariance { texture: vec![Texture { exponent: 0.5, factor: 2.0 }], ..white() };
        // Over the last three of six: the modes of equal variances are as the axes are.
        assert!((known.texture_factor(0, &[0.0, 0.0, 0.0, 2.0, 2.0, 2.0]) - 4.0).abs() < 1e-9);
        assert!((known.texture_factor(0, &[0.0; 6]) - 0.2).abs() < 1e-9, "as rough as measured at the least");
        assert!((known.texture_factor(0, &[2.0; 5]) - 1.0).abs() < 1e-9, "seen for too short a time");
        assert!((white().texture_factor(0, &[9.0; 6]) - 1.0).abs() < 1e-9);
    }

    /// Two cars at 10 m/s, the second of which was observed to move by centimeters to and fro.
    fn one_trembles() -> Scene {
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 4.0, 0.0, 10.0)]);
        let trembles = |(t, state): (usize, &Option<State>)| {
            let aside = Vec2::new(0.0, if t % 2 == 0 { 0.02 } else { -0.02 });
            state.map(|state| State { position: state.position + aside, ..state })
        };
        let states = scene.tracks[1].trajectory.entries().iter().enumerate().map(trembles).collect();
        scene.tracks[1].trajectory = Trajectory::new(states);
        scene
    }

    #[test]
    fn fast_modes_of_who_was_seen_to_tremble_have_larger_variances() {
        let scene = one_trembles();
        let mut collator = collator([&scene], StateParametrization::Motion);
        let (n_past, n) = (scene.n_history - 1, scene.n_timesteps - scene.n_history);
        let size = n_past + n;
        let values = vec![grid(size, size, |i, j| f64::from(u8::from(i == j)) * 0.01); 3];
        let mut covariance = MotionCovariance::new(n_past, n, values, vec![1e-9; 3]);
        covariance.texture = vec![Texture { exponent: 1.0, factor: 1.0 }; 3];
        collator.normalizer.motion_covariance = Some(covariance);
        collator.sight = Some(Sight::new(1));
        let batch = collator.predictive(&[&scene], super::super::FutureValidity::Everything);
        let variances = batch.surroundings.as_ref().unwrap().variances.get(0).unwrap().to_vec3::<f32>().unwrap();
        let largest = |agent: usize| variances[agent][1].iter().copied().fold(0.0, f32::max);
        assert!(largest(1) > 2.0 * largest(0), "{variances:?}");
    }
}
