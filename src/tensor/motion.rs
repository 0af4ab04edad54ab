//! Residuals to residual motion and back: smooth paths from independent numbers.
//!
//! Independent errors of a few centimeters in neighboring positions are accelerations that no vehicle reaches. The
//! motion parametrization diffuses instead the numbers z from which a Brownian path makes the residuals r of an agent:
//! away from its observed states r is the running sum of z, and between two of them a Brownian bridge. For any z, r is
//! continuous with the observed states, and small errors in z are small errors in velocity.

/// How the residual of one latent timestep follows from that of the timestep before it in the chain.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Link {
    timestep: usize,
    /// Place in the chain of the latent timestep it starts from; `None` if that is an observed state, whose residual
    /// is 0.
    from: Option<usize>,
    /// The factor of that residual.
    carry: f64,
    /// Standard deviation of the increment, per unit of z.
    scale: f64,
}

/// The change of variables of one agent. It is linear and invertible, and depends only on which timesteps are observed
/// and which are latent.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MotionChain {
    links: Vec<Link>,
}

impl MotionChain {
    /// The chain through the `latent` timesteps of an agent that is observed at the `observed` ones; both ascend, and
    /// neither is shared. Without an observed timestep every link stands alone (z = r).
    pub(super) fn new(observed: &[usize], latent: &[usize]) -> Self {
        let Some(first_observed) = observed.first() else {
            let alone = |timestep: &usize| Link { timestep: *timestep, from: None, carry: 0.0, scale: 1.0 };
            return Self { links: latent.iter().map(alone).collect() };
        };
        let mut links: Vec<Link> = Vec::with_capacity(latent.len());
        // Before the first observed state the path is followed backward in time.
        let n_before = latent.partition_point(|timestep| timestep < first_observed);
        let mut nearer = *first_observed;
        for (i, timestep) in latent[..n_before].iter().rev().enumerate() {
            let scale = ((nearer - timestep) as f64).sqrt();
            links.push(Link { timestep: *timestep, from: i.checked_sub(1), carry: 1.0, scale });
            nearer = *timestep;
        }
        for (i, &timestep) in latent.iter().enumerate().skip(n_before) {
            let after = observed.partition_point(|t| *t < timestep);
            let last_observed = observed[after - 1];
            let before = latent[n_before..i].last().copied().filter(|t| *t > last_observed);
            let elapsed = (timestep - before.unwrap_or(last_observed)) as f64;
            let (carry, variance) = observed.get(after).map_or((1.0, elapsed), |next| {
                let left = (next - timestep) as f64;
                (left / (elapsed + left), elapsed * left / (elapsed + left))
            });
            links.push(Link { timestep, from: before.map(|_| i - 1), carry, scale: variance.sqrt() });
        }
        Self { links }
    }

    /// The numbers z of each timestep for the residuals r that `residual` returns; z is 0 if a residual is unknown.
    pub(super) fn encode<const D: usize>(
        &self,
        mut residual: impl FnMut(usize) -> Option<[f64; D]>,
    ) -> Vec<(usize, [f64; D])> {
        let mut residuals: Vec<[f64; D]> = Vec::with_capacity(self.links.len());
        let mut encoded = Vec::with_capacity(self.links.len());
        for link in &self.links {
            let carried = link.from.map_or([0.0; D], |from| residuals[from].map(|r| link.carry * r));
            let own = residual(link.timestep).unwrap_or(carried);
            encoded.push((link.timestep, std::array::from_fn(|i| (own[i] - carried[i]) / link.scale)));
            residuals.push(own);
        }
        encoded
    }

    /// The covariance of the numbers z in the order of the chain, row by row; `residual` returns the covariance of the
    /// residuals of two latent timesteps.
    pub(super) fn covariance(&self, residual: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        // z is (r - carry r') / scale, with r' at the timestep before in the chain.
        let terms = |link: &Link| {
            let carried = link.from.map(|from| (self.links[from].timestep, -link.carry / link.scale));
            [Some((link.timestep, link.scale.recip())), carried]
        };
        let pair = |a: &Link, b: &Link| {
            let (a, b) = (terms(a), terms(b));
            a.iter()
                .flatten()
                .flat_map(|x| b.iter().flatten().map(move |y| (x, y)))
                .map(|((t, x), (u, y))| x * y * residual(*t, *u))
                .sum::<f64>()
        };
        self.links.iter().flat_map(|a| self.links.iter().map(move |b| pair(a, b))).collect()
    }

    /// The matrix G of r = G z over `n_timesteps`, row by row; zero at timesteps that are not latent.
    pub(super) fn matrix(&self, n_timesteps: usize) -> Vec<f32> {
        let mut matrix = vec![0.0; n_timesteps * n_timesteps];
        for link in &self.links {
            let row = link.timestep * n_timesteps;
            if let Some(from) = link.from {
                let source = self.links[from].timestep * n_timesteps;
                for column in 0..n_timesteps {
                    matrix[row + column] = link.carry * matrix[source + column];
                }
            }
            matrix[row + link.timestep] = link.scale;
        }
        matrix.into_iter().map(|value| value as f32).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// G Gᵀ, the covariance of the residuals when z is white.
    fn covariance(chain: &MotionChain, n: usize) -> Vec<Vec<f64>> {
        let g: Vec<f64> = chain.matrix(n).into_iter().map(f64::from).collect();
        let entry = |i: usize, j: usize| (0..n).map(|k| g[i * n + k] * g[j * n + k]).sum();
        (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect()
    }

    #[test]
    fn white_numbers_make_a_brownian_path_with_bridges() {
        // Observed at 3 and 8 of twelve timesteps; 5 is not tracked.
        let chain = MotionChain::new(&[3, 8], &[0, 1, 2, 4, 6, 7, 9, 11]);
        let covariance = covariance(&chain, 12);
        let expected = |i: i64, j: i64| -> f64 {
            match (i, j) {
                (0..=2, 0..=2) => (3 - i.max(j)) as f64,
                (4..=7, 4..=7) if i != 5 && j != 5 => ((i.min(j) - 3) * (8 - i.max(j))) as f64 / 5.0,
                (9..=11, 9..=11) if i != 10 && j != 10 => (i.min(j) - 8) as f64,
                _ => 0.0,
            }
        };
        for (i, row) in covariance.iter().enumerate() {
            for (j, found) in row.iter().enumerate() {
                assert!((found - expected(i as i64, j as i64)).abs() < 1e-5, "{i} {j}: {found}");
            }
        }
    }

    #[test]
    fn encoding_is_the_inverse_of_the_matrix() {
        let (observed, latent) = (vec![2, 6], vec![0, 1, 3, 4, 5, 7, 8, 9]);
        for observed in [observed, Vec::new()] {
            let chain = MotionChain::new(&observed, &latent);
            let residual = |t: usize| [(t as f64 * 1.7).sin(), t as f64];
            let encoded = chain.encode(|t| Some(residual(t)));
            let g = chain.matrix(10);
            for t in latent.iter().copied() {
                for d in 0..2 {
                    let decoded: f64 = encoded.iter().map(|(s, z)| f64::from(g[t * 10 + s]) * z[d]).sum();
                    assert!((decoded - residual(t)[d]).abs() < 1e-5, "{t}");
                }
            }
        }
        // An unknown step follows from the one before it.
        let partly = MotionChain::new(&[0], &[1, 2, 3]).encode(|t| (t != 2).then_some([t as f64]));
        assert_eq!(partly, [(1, [1.0]), (2, [0.0]), (3, [2.0])]);
    }
}
