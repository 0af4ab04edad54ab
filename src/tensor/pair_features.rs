//! The inputs of a pairwise classifier: two agents with a diffused future.

use super::{Normalizer, SceneBatch, StateParametrization};
use crate::geometry::{Transform2, Vec2, wrap_angle};
use candle_core::{Result, Tensor};

/// Meters per unit of the fixed positions: about the distance of two agents that meet.
const POSITION_UNIT_M: f32 = 20.0;
/// Fixed features of an agent at a timestep: base position (2), cosine and sine of the base heading, observed, latent.
const FIXED: usize = 6;

/// Features of one pair of agents a row, differentiable in the diffused states.
///
/// Everything is expressed in the pair's frame: that of the first agent at its last observed state. Known values
/// (observed states, kinematic reference) are fixed; diffused states are scaled by c_in(σ), so that their magnitude
/// does not depend on the noise level. In the scene parametrization they are turned into the pair's frame; in the
/// motion one they already are in each agent's own, and the features are the sums of motion, with rows of equal noise,
/// so that gradients move whole paths and not single timesteps.
#[derive(Debug, Clone)]
pub struct PairFeatures {
    rows: Tensor,
    latent: Tensor,
    rotation: Option<(Tensor, Tensor)>,
    path: Option<Tensor>,
    fixed: Tensor,
    n_pairs: usize,
}

impl PairFeatures {
    /// Number of features of a pair over `n_timesteps` with `state_dim` diffused dimensions.
    pub const fn n_features(n_timesteps: usize, state_dim: usize) -> usize {
        2 * n_timesteps * (FIXED + state_dim)
    }

    /// The features of agents `pairs[b]` = (first, second) of row b, as places on the batch's agent axis.
    ///
    /// # Errors
    /// Fails when there is not one pair per row or a place lies outside the agent axis.
    pub fn new(batch: &SceneBatch, pairs: &[(usize, usize)], parametrization: StateParametrization) -> Result<Self> {
        let (n_rows, n_agents, n_timesteps, _) = batch.x0.dims4()?;
        if pairs.len() != n_rows || pairs.iter().any(|(first, second)| (*first).max(*second) >= n_agents) {
            candle_core::bail!("{} pairs given for {n_rows} rows of {n_agents} agents", pairs.len());
        }
        let device = batch.x0.device();
        let flat = |(row, (first, second)): (usize, &(usize, usize))| {
            [(row * n_agents + first) as u32, (row * n_agents + second) as u32]
        };
        let rows: Vec<u32> = pairs.iter().enumerate().flat_map(flat).collect();
        let rows = Tensor::from_vec(rows, n_rows * 2, device)?;
        let select = |tensor: &Tensor, shape: &[usize]| tensor.reshape(shape)?.index_select(&rows, 0);
        let host = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        let base = host(&select(&batch.base, &[n_rows * n_agents, n_timesteps, 3])?)?;
        let observed = host(&select(&batch.observed, &[n_rows * n_agents, n_timesteps])?)?;
        let latent = select(&batch.latent, &[n_rows * n_agents, n_timesteps])?;
        let latent_entries = host(&latent)?;

        let mut fixed = Vec::with_capacity(n_rows * 2 * n_timesteps * FIXED);
        let mut headings = Vec::with_capacity(n_rows * 2);
        for row in 0..n_rows {
            let first = row * 2 * n_timesteps;
            let last_observed = observed[first..first + n_timesteps].iter().rposition(|o| *o > 0.0).unwrap_or(0);
            let origin = &base[(first + last_observed) * 3..][..3];
            let pair_from_row = pose(origin).inverse();
            headings.extend([wrap_angle(-f64::from(origin[2])) as f32; 2]);
            for state in first..first + 2 * n_timesteps {
                let masks = [observed[state], latent_entries[state]];
                fixed.extend(fixed_features(&pair_from_row, &base[state * 3..][..3], masks));
            }
        }
        let rotation = match parametrization {
            StateParametrization::Motion => None,
            StateParametrization::Scene => {
                let angles = Tensor::from_vec(headings, (n_rows * 2, 1, 1), device)?;
                Some((angles.cos()?, angles.sin()?))
            }
        };
        let path = batch.unit_path()?;
        let path = path.map(|path| select(&path, &[n_rows * n_agents, n_timesteps, n_timesteps])).transpose()?;
        let fixed = Tensor::from_vec(fixed, (n_rows, 2 * n_timesteps * FIXED), device)?;
        Ok(Self { rows, latent: latent.unsqueeze(2)?, rotation, path, fixed, n_pairs: n_rows })
    }

    /// The features (B, F) for diffused states `x` (B, A, T, D) at noise levels `sigma` (B).
    ///
    /// # Errors
    /// Fails when shapes do not agree with the batch the features were made for.
    pub fn forward(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let (n_rows, n_agents, n_timesteps, state_dim) = x.dims4()?;
        let x = x.reshape((n_rows * n_agents, n_timesteps, state_dim))?.index_select(&self.rows, 0)?;
        let x = x.broadcast_mul(&self.latent)?;
        let x = self.path.as_ref().map_or(Ok(x.clone()), |path| path.matmul(&x))?;
        let x = match &self.rotation {
            None => x,
            Some((cos, sin)) => {
                let (px, py) = (x.narrow(2, 0, 1)?, x.narrow(2, 1, 1)?);
                let turned_x = (px.broadcast_mul(cos)? - py.broadcast_mul(sin)?)?;
                let turned_y = (px.broadcast_mul(sin)? + py.broadcast_mul(cos)?)?;
                let mut parts = vec![turned_x, turned_y];
                if state_dim > 2 {
                    parts.push(x.narrow(2, 2, state_dim - 2)?);
                }
                Tensor::cat(&parts, 2)?
            }
        };
        let c_in = (sigma.sqr()? + Normalizer::SIGMA_DATA.powi(2))?.sqrt()?.recip()?;
        let x = x.reshape((self.n_pairs, 2 * n_timesteps * state_dim))?.broadcast_mul(&c_in.unsqueeze(1)?)?;
        Tensor::cat(&[&self.fixed, &x], 1)
    }
}

/// The transform from the frame at a base state (x, y, heading) to the row's frame.
fn pose(state: &[f32]) -> Transform2 {
    Transform2::from_pose(Vec2::new(f64::from(state[0]), f64::from(state[1])), f64::from(state[2]))
}

/// The fixed features of an agent at a timestep, in the pair's frame; zeros if it is neither observed nor latent.
fn fixed_features(pair_from_row: &Transform2, base: &[f32], [observed, latent]: [f32; 2]) -> [f32; FIXED] {
    if observed + latent == 0.0 {
        return [0.0; FIXED];
    }
    let position = pair_from_row.point(Vec2::new(f64::from(base[0]), f64::from(base[1])));
    let (sin, cos) = pair_from_row.heading(f64::from(base[2])).sin_cos();
    let (x, y) = (position.x as f32 / POSITION_UNIT_M, position.y as f32 / POSITION_UNIT_M);
    [x, y, cos as f32, sin as f32, observed, latent]
}
