//! D_θ: the preconditioned network as a denoiser of scenes.

use super::network::{Known, NetworkConfig, SceneNetwork};
use crate::diffusion::{Denoiser, Edm, rows_like, sigma_rows};
use crate::nn::{Params, Scope};
use crate::seed::Seed;
use crate::tensor::SceneBatch;
use candle_core::{Result, Tensor};

/// DJINN's denoiser, D_θ(x; σ) = c_skip(σ) x + c_out(σ) F_θ(c_in(σ) x, …, c_noise(σ)).
#[derive(Debug, Clone)]
pub struct SceneDenoiser {
    network: SceneNetwork,
    edm: Edm,
    path_input: bool,
}

impl SceneDenoiser {
    /// A denoiser whose parameters live in `params`; those that are not there yet are drawn from `seed`.
    ///
    /// # Errors
    /// Fails when the configuration is no network.
    pub fn new(params: &mut Params, config: &NetworkConfig, state_dim: usize, edm: Edm, seed: Seed) -> Result<Self> {
        Ok(Self {
            network: SceneNetwork::new(&mut Scope::root(params, seed), config, state_dim)?,
            edm,
            path_input: config.path_input,
        })
    }

    /// The constants of its diffusion.
    pub const fn edm(&self) -> &Edm {
        &self.edm
    }

    /// The denoiser conditioned on the observed states and maps of `batch`, for `n_samples` samples of every row:
    /// rows b · n_samples to (b + 1) · n_samples - 1 of its input belong to row b of the batch. What all samples of a
    /// scene share is computed once.
    ///
    /// # Errors
    /// Fails when the batch does not fit the network.
    pub fn bind(&self, batch: &SceneBatch, n_samples: usize) -> Result<BoundDenoiser<'_>> {
        let known = self.network.encode_known(
            &batch.context,
            &batch.features,
            &batch.valid,
            &batch.latent,
            (&batch.lanes, &batch.lane_valid),
        )?;
        let latent = batch.latent.unsqueeze(3)?;
        let path = if self.path_input { batch.unit_path()? } else { None };
        if self.path_input && path.is_none() {
            candle_core::bail!("path_input needs the motion parametrization");
        }
        let observed_motion = batch.observed_motion.clone();
        if n_samples == 1 {
            return Ok(BoundDenoiser { denoiser: self, known, latent, observed_motion, path });
        }
        let repeated = batch.latent.unsqueeze(1)?.repeat((1, n_samples, 1, 1))?.flatten(0, 1)?.unsqueeze(3)?;
        let repeat = |tensor: Tensor| -> Result<Tensor> {
            let (shape, inner) = (tensor.dims().to_vec(), tensor.unsqueeze(1)?);
            let wide: Vec<usize> = [shape[0], n_samples].into_iter().chain(shape[1..].iter().copied()).collect();
            inner.broadcast_as(wide)?.contiguous()?.flatten(0, 1)
        };
        Ok(BoundDenoiser {
            denoiser: self,
            known: known.repeated(n_samples)?,
            latent: repeated,
            observed_motion: observed_motion.map(repeat).transpose()?,
            path: path.map(repeat).transpose()?,
        })
    }
}

/// A denoiser bound to observed states and maps. Its estimate is zero wherever a state is not latent.
#[derive(Debug, Clone)]
pub struct BoundDenoiser<'a> {
    denoiser: &'a SceneDenoiser,
    known: Known,
    latent: Tensor,
    /// What the network sees in the place of x where states are observed, (B, A, T, D).
    observed_motion: Option<Tensor>,
    /// What makes residuals of unit variance out of white motion, (B, A, T, T), where the network sees them.
    path: Option<Tensor>,
}

impl BoundDenoiser<'_> {
    /// 1 on latent entries, (B, A, T, 1).
    pub const fn latent(&self) -> &Tensor {
        &self.latent
    }
}

impl Denoiser for BoundDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let edm = &self.denoiser.edm;
        let sigmas = sigma_rows(sigma)?;
        let rows = |value: &dyn Fn(f64) -> f64| rows_like(sigmas.iter().map(|s| value(*s)).collect(), x);
        let c_noise = rows(&|s| edm.c_noise(s))?.flatten_all()?;
        let x = x.broadcast_mul(&self.latent)?;
        let scaled = x.broadcast_mul(&rows(&|s| edm.c_in(s))?)?;
        let moved = match &self.observed_motion {
            Some(motion) => (&scaled + motion)?,
            None => scaled.clone(),
        };
        let seen = match &self.path {
            Some(path) => Tensor::cat(&[&moved, &path.matmul(&scaled)?], 3)?,
            None => moved,
        };
        let f_x = self.denoiser.network.forward(&seen, &self.known, &c_noise)?;
        let skipped = x.broadcast_mul(&rows(&|s| edm.c_skip(s))?)?;
        let estimate = (skipped + f_x.broadcast_mul(&rows(&|s| edm.c_out(s))?)?)?;
        estimate.broadcast_mul(&self.latent)
    }
}
