//! Gaussian mixtures with diagonal covariances, fitted by expectation-maximization.
//!
//! The paper fits six components to 60 samples of an agent's future positions, 60 numbers each. This is singular in two
//! ways (fewer points than numbers, and components of one point), so variances have a floor. The floor is the
//! constrained maximum of the M step, not an added term, so the log-likelihood never falls.

use crate::seed::{Seed, SeededRng};
use std::f64::consts::TAU;

/// A fit ends when the log-likelihood rises by less than this share of its size.
const TOLERANCE: f64 = 1e-9;
/// Most iterations of expectation and maximization, which settle in a few dozen.
const MAX_ITERATIONS: usize = 100;
/// Fits from different starts; the likeliest is used.
const N_STARTS: u64 = 4;
/// Least standard deviation of a component in any dimension, in the unit of the points. For positions in meters, this
/// is far below the differences between futures.
const MIN_STD: f64 = 0.1;
/// Components with less weight have lost all points.
const NO_WEIGHT: f64 = 1e-12;

/// One Gaussian of a mixture.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// Its share of the mixture; the weights of a mixture sum to 1.
    pub weight: f64,
    /// Its mean.
    pub mean: Vec<f64>,
    /// The diagonal of its covariance.
    pub variance: Vec<f64>,
}

/// A mixture fitted to points.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixture {
    /// The components, by decreasing weight. Fewer than configured if points coincide.
    pub components: Vec<Component>,
    /// The probability of each component for each point, in the order of the components.
    pub responsibilities: Vec<Vec<f64>>,
    /// The log-likelihood of the points after each iteration; never falls, except by rounding.
    pub log_likelihoods: Vec<f64>,
}

impl Mixture {
    /// Fits a mixture to points of equal length. The starts are means drawn by k-means++ (Arthur and
    /// Vassilvitskii 2007) from `seed`, to which points are assigned whole.
    ///
    /// `None` without components, with fewer points than components, or with points that are empty, of different
    /// lengths or not finite.
    pub fn fit(points: &[Vec<f64>], n_components: usize, seed: Seed) -> Option<Self> {
        let n_dims = points.first()?.len();
        let is_usable = |point: &Vec<f64>| point.len() == n_dims && point.iter().all(|x| x.is_finite());
        if n_dims == 0 || n_components == 0 || points.len() < n_components || !points.iter().all(is_usable) {
            return None;
        }
        let start = |start: u64| {
            let mut rng = seed.derive("mixture", &[start]).rng();
            Self::fit_from(points, &spread_out(points, n_components, &mut rng), MAX_ITERATIONS, MIN_STD)
        };
        // The first among equally likely fits counts.
        let better =
            |best: Self, other: Self| if other.log_likelihood() > best.log_likelihood() { other } else { best };
        (0..N_STARTS).map(start).reduce(better).map(Self::sorted)
    }

    /// Fits a mixture from given means. Components are in the order of the means, whatever their weight.
    fn fit_from(points: &[Vec<f64>], means: &[Vec<f64>], max_iterations: usize, min_std: f64) -> Self {
        let unfitted = |mean: &Vec<f64>| Component {
            weight: 0.0,
            mean: mean.clone(),
            variance: vec![min_std.powi(2); mean.len()],
        };
        let mut components: Vec<Component> = means.iter().map(unfitted).collect();
        let mut responsibilities: Vec<Vec<f64>> = points.iter().map(|point| of_nearest(point, means)).collect();
        let mut log_likelihoods: Vec<f64> = Vec::new();
        for _ in 0..max_iterations {
            maximize(points, &responsibilities, min_std, &mut components);
            let log_likelihood = expect(points, &components, &mut responsibilities);
            let gain = log_likelihoods.last().map(|last| log_likelihood - last);
            log_likelihoods.push(log_likelihood);
            if gain.is_some_and(|gain| gain <= TOLERANCE * log_likelihood.abs()) {
                break;
            }
        }
        Self { components, responsibilities, log_likelihoods }
    }

    /// The mixture with its components by decreasing weight (a stable order), without components that have no points.
    fn sorted(self) -> Self {
        let mut order: Vec<usize> =
            (0..self.components.len()).filter(|k| self.components[*k].weight > NO_WEIGHT).collect();
        order.sort_by(|a, b| self.components[*b].weight.total_cmp(&self.components[*a].weight));
        let of_point = |shares: &Vec<f64>| order.iter().map(|k| shares[*k]).collect();
        Self {
            components: order.iter().map(|k| self.components[*k].clone()).collect(),
            responsibilities: self.responsibilities.iter().map(of_point).collect(),
            log_likelihoods: self.log_likelihoods,
        }
    }

    fn log_likelihood(&self) -> f64 {
        self.log_likelihoods.last().copied().unwrap_or(f64::NEG_INFINITY)
    }
}

/// k-means++: the first center is any point, each further one a point drawn with a probability proportional to its
/// squared distance from the nearest center so far.
fn spread_out(points: &[Vec<f64>], n_centers: usize, rng: &mut SeededRng) -> Vec<Vec<f64>> {
    let mut centers = vec![points[rng.below(points.len())].clone()];
    let mut nearest: Vec<f64> = points.iter().map(|point| squared_distance(point, &centers[0])).collect();
    while centers.len() < n_centers {
        let total: f64 = nearest.iter().sum();
        let mut left = rng.uniform() * total;
        // If all points coincide with centers, any of them will do. The last one absorbs rounding.
        let drawn = nearest.iter().position(|d| {
            left -= d;
            left < 0.0
        });
        let farthest = || nearest.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i);
        let center = points[drawn.unwrap_or_else(farthest)].clone();
        for (distance, point) in nearest.iter_mut().zip(points) {
            *distance = distance.min(squared_distance(point, &center));
        }
        centers.push(center);
    }
    centers
}

/// Assigns each point to the nearest of `means`, the first of equals.
fn of_nearest(point: &[f64], means: &[Vec<f64>]) -> Vec<f64> {
    let distances = means.iter().map(|mean| squared_distance(point, mean));
    let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(k, _)| k);
    (0..means.len()).map(|k| if k == nearest { 1.0 } else { 0.0 }).collect()
}

fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

/// The M step: weights, means and floored variances that make the points likeliest. A component without points keeps
/// its mean and variance.
fn maximize(points: &[Vec<f64>], responsibilities: &[Vec<f64>], min_std: f64, components: &mut [Component]) {
    for (k, component) in components.iter_mut().enumerate() {
        let share: f64 = responsibilities.iter().map(|shares| shares[k]).sum();
        component.weight = share / points.len() as f64;
        if component.weight <= NO_WEIGHT {
            continue;
        }
        let weighted_mean = |value: &dyn Fn(&[f64]) -> f64| {
            points.iter().zip(responsibilities).map(|(point, shares)| shares[k] * value(point)).sum::<f64>() / share
        };
        for dim in 0..component.mean.len() {
            let mean = weighted_mean(&|point| point[dim]);
            component.mean[dim] = mean;
            component.variance[dim] = weighted_mean(&|point| (point[dim] - mean).powi(2)).max(min_std * min_std);
        }
    }
}

/// The E step: the probability of each component for each point. Returns the log-likelihood of the points.
fn expect(points: &[Vec<f64>], components: &[Component], responsibilities: &mut [Vec<f64>]) -> f64 {
    let constants: Vec<f64> = components
        .iter()
        .map(|c| c.weight.ln() - 0.5 * c.variance.iter().map(|variance| (TAU * variance).ln()).sum::<f64>())
        .collect();
    let mut log_likelihood = 0.0;
    for (point, shares) in points.iter().zip(responsibilities) {
        for ((share, component), constant) in shares.iter_mut().zip(components).zip(&constants) {
            let standardized = point.iter().zip(&component.mean).zip(&component.variance);
            *share = constant - 0.5 * standardized.map(|((x, mean), v)| (x - mean) * (x - mean) / v).sum::<f64>();
        }
        // log Σ exp, without overflow.
        let largest = shares.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let log_density = largest + shares.iter().map(|log| (log - largest).exp()).sum::<f64>().ln();
        shares.iter_mut().for_each(|share| *share = (*share - log_density).exp());
        log_likelihood += log_density;
    }
    log_likelihood
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde::Deserialize;

    fn all_near(a: &[f64], b: &[f64], tolerance: f64) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() <= tolerance)
    }

    #[test]
    fn two_pairs_by_hand() {
        let points = [0.0, 2.0, 100.0, 104.0, 102.0].map(|x| vec![x]);
        let mixture = Mixture::fit(&points, 2, Seed(1)).expect("fits");
        let [first, second] = &mixture.components[..] else { panic!("{mixture:?}") };
        // Each point belongs to one component only, within the precision of an f64.
        assert!(all_near(&[first.weight, first.mean[0], first.variance[0]], &[0.6, 102.0, 8.0 / 3.0], 1e-9));
        assert!(all_near(&[second.weight, second.mean[0], second.variance[0]], &[0.4, 1.0, 1.0], 1e-9));
        // Σ ln(weight · N(x; mean, variance)), written out.
        let of_pair = |weight: f64, variance: f64, n: f64| n * (weight.ln() - 0.5 * (TAU * variance).ln() - 0.5);
        let expected = of_pair(0.6, 8.0 / 3.0, 3.0) + of_pair(0.4, 1.0, 2.0);
        assert!((mixture.log_likelihoods.last().expect("iterated") - expected).abs() < 1e-9);
    }

    #[test]
    fn the_floor_holds_and_coinciding_points_need_fewer_components() {
        let points = vec![vec![1.0, 2.0]; 5];
        let mixture = Mixture::fit(&points, 3, Seed(1)).expect("fits");
        assert_eq!(mixture.components.len(), 1);
        let component = &mixture.components[0];
        assert!(all_near(&component.mean, &[1.0, 2.0], 1e-12) && all_near(&component.variance, &[0.01, 0.01], 1e-12));
        assert_eq!(component.weight, 1.0);
    }

    #[test]
    fn what_cannot_be_fitted_is_refused() {
        let refused = |points: &[Vec<f64>], n: usize| Mixture::fit(points, n, Seed(1)).is_none();
        let points = vec![vec![1.0], vec![2.0], vec![3.0]];
        assert!(!refused(&points, 3));
        assert!(refused(&points[..2], 3) && refused(&[], 3));
        assert!(refused(&[vec![], vec![], vec![]], 3));
        assert!(refused(&[vec![1.0], vec![f64::NAN], vec![3.0]], 3));
        assert!(refused(&[vec![1.0], vec![1.0, 2.0], vec![3.0]], 3));
        assert!(refused(&points, 0));
    }

    /// 60 points of 60 numbers around three well separated centers: 30, 20 and 10 points.
    fn clusters(seed: u64) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let mut rng = Seed(seed).rng();
        let centers: Vec<Vec<f64>> = (0..3).map(|_| (0..60).map(|_| 10.0 * rng.normal()).collect()).collect();
        let point = |i: usize, rng: &mut SeededRng| {
            let center = &centers[if i < 30 { 0 } else { usize::from(i >= 50) + 1 }];
            center.iter().map(|x| x + rng.normal()).collect()
        };
        let points = (0..60).map(|i| point(i, &mut rng)).collect();
        (points, centers)
    }

    #[test]
    fn well_separated_clusters_are_found() {
        for seed in 0..5 {
            let (points, centers) = clusters(seed);
            let mixture = Mixture::fit(&points, 3, Seed(7)).expect("fits");
            let weights: Vec<f64> = mixture.components.iter().map(|component| component.weight).collect();
            assert!(all_near(&weights, &[0.5, 1.0 / 3.0, 1.0 / 6.0], 1e-9), "{weights:?}");
            for (component, center) in mixture.components.iter().zip(&centers) {
                // The mean of ten unit normals has a standard deviation of 0.32: 1.6 are five of them.
                assert!(all_near(&component.mean, center, 1.6));
            }
            assert!(mixture.responsibilities[..30].iter().all(|shares| shares[0] > 0.999));
        }
    }

    #[derive(Deserialize)]
    struct Golden {
        min_std: f64,
        points: Vec<Vec<f64>>,
        starts: Vec<Vec<f64>>,
        n_iterations: usize,
        weights: Vec<f64>,
        means: Vec<Vec<f64>>,
        variances: Vec<Vec<f64>>,
        log_likelihoods: Vec<f64>,
    }

    /// `scripts/golden_mixture.py` writes the file.
    #[test]
    fn iterations_are_those_of_another_program() {
        let golden: Golden =
            serde_json::from_str(include_str!("../../tests/golden/mixture.json")).expect("a golden file");
        let mixture = Mixture::fit_from(&golden.points, &golden.starts, golden.n_iterations, golden.min_std);
        assert!(all_near(&mixture.log_likelihoods, &golden.log_likelihoods, 1e-8));
        for (k, component) in mixture.components.iter().enumerate() {
            assert!((component.weight - golden.weights[k]).abs() < 1e-10);
            assert!(all_near(&component.mean, &golden.means[k], 1e-9));
            assert!(all_near(&component.variance, &golden.variances[k], 1e-9));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn the_likelihood_never_falls(
            points in prop::collection::vec(prop::collection::vec(-3.0..3.0f64, 4), 6..30), seed in 0..1000u64,
        ) {
            let mixture = Mixture::fit(&points, 3, Seed(seed)).expect("fits");
            for pair in mixture.log_likelihoods.windows(2) {
                prop_assert!(pair[1] >= pair[0] - 1e-9 * pair[0].abs().max(1.0), "{:?}", mixture.log_likelihoods);
            }
            let weights: f64 = mixture.components.iter().map(|component| component.weight).sum();
            prop_assert!((weights - 1.0).abs() < 1e-9);
            for shares in &mixture.responsibilities {
                prop_assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            }
        }
    }
}
