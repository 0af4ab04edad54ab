//! D_θ: the preconditioned network as a denoiser of scenes.

use super::geometric_network::{GeometricNetwork, KnownTokens};
use super::network::{Known, NetworkConfig, SceneNetwork};
use crate::diffusion::{Denoiser, Edm, SIGMA_DATA, rows_like, sigma_rows};
use crate::nn::ops::mode_filter;
use crate::nn::{Params, Scope};
use crate::seed::Seed;
use crate::tensor::{RepeatedRows, SceneBatch};
use candle_core::{Result, Tensor};

/// A denoiser of scenes, with DJINN's network or the geometric one.
///
/// DJINN's is D_θ(x; σ) = c_skip(σ) x + c_out(σ) F_θ(c_in(σ) x, …, c_noise(σ)). The geometric one has factors of its
/// own for each mode of an agent's motion, whose variance Λ is known: D_θ(x; σ) = W x + Uᵀ c_out(σ, Λ) U F_θ(…) with W
/// = Uᵀ w(σ, Λ) U, where w = λ / (λ + σ²), λ = min(Λ, σ_data²), and c_out² = (1 - w)² Λ + w² σ², so that the target of
/// F_θ has unit variance (Karras et al. 2022, appendix B.6). The cap keeps W from trusting large modes more than EDM
/// does.
#[derive(Debug, Clone)]
pub struct SceneDenoiser {
    network: Network,
    edm: Edm,
}

#[derive(Debug, Clone)]
enum Network {
    /// DJINN's, and whether it sees the residuals that motion adds up to.
    Scene(Box<SceneNetwork>, bool),
    Geometric(Box<GeometricNetwork>),
}

impl SceneDenoiser {
    /// A denoiser whose parameters live in `params`; missing ones are drawn from `seed`.
    ///
    /// # Errors
    /// Fails when the configuration is not that of a network.
    pub fn new(params: &mut Params, config: &NetworkConfig, state_dim: usize, edm: Edm, seed: Seed) -> Result<Self> {
        let mut scope = Scope::root(params, seed);
        let network = match &config.geometry {
            None => Network::Scene(Box::new(SceneNetwork::new(&mut scope, config, state_dim)?), config.path_input),
            Some(geometry) => {
                Network::Geometric(Box::new(GeometricNetwork::new(&mut scope, config, geometry, state_dim)?))
            }
        };
        Ok(Self { network, edm })
    }

    /// The constants of its diffusion.
    pub const fn edm(&self) -> &Edm {
        &self.edm
    }

    /// The denoiser conditioned on the observed states and maps of `batch`, for `n_samples` samples of every row: rows
    /// b · n_samples to (b + 1) · n_samples - 1 of its input belong to row b of the batch. Results that all samples of
    /// a scene share are computed once.
    ///
    /// # Errors
    /// Fails when the batch does not fit the network.
    pub fn bind(&self, batch: &SceneBatch, n_samples: usize) -> Result<BoundDenoiser<'_>> {
        let rows = RepeatedRows::new(batch.n_rows(), n_samples, batch.latent.device())?;
        let latent = rows.tensor(&batch.latent.unsqueeze(3)?)?;
        let observed_motion = batch.observed_motion.as_ref().map(|motion| rows.tensor(motion)).transpose()?;
        let unit_path = || match batch.unit_path()? {
            Some(path) => rows.tensor(&path),
            None => candle_core::bail!("a network that sees paths needs the motion parametrization"),
        };
        let network = match &self.network {
            Network::Scene(network, path_input) => {
                let known = network.encode_known(
                    &batch.context,
                    &batch.features,
                    &batch.valid,
                    &batch.latent,
                    (&batch.lanes, &batch.lane_valid),
                )?;
                let known = if n_samples == 1 { known } else { known.repeated(n_samples)? };
                Bound::Scene { network, known, path: path_input.then(unit_path).transpose()? }
            }
            Network::Geometric(network) => {
                let known = network.encode_known(batch)?;
                let (known, batch) = match n_samples {
                    1 => (known, batch.clone()),
                    n => (known.repeated(n)?, batch.repeated(n)?),
                };
                Bound::Geometric(Box::new(BoundGeometric { network, known, batch, path: unit_path()? }))
            }
        };
        Ok(BoundDenoiser { edm: &self.edm, network, latent, observed_motion })
    }
}

/// A denoiser bound to observed states and maps. Its estimate is zero wherever a state is not latent.
#[derive(Debug, Clone)]
pub struct BoundDenoiser<'a> {
    edm: &'a Edm,
    network: Bound<'a>,
    latent: Tensor,
    /// The input in place of x for observed states, (B, A, T, D).
    observed_motion: Option<Tensor>,
}

#[derive(Debug, Clone)]
enum Bound<'a> {
    Scene {
        network: &'a SceneNetwork,
        known: Known,
        /// The matrices that turn white motion into residuals of unit variance, (B, A, T, T), if the network sees them.
        path: Option<Tensor>,
    },
    Geometric(Box<BoundGeometric<'a>>),
}

#[derive(Debug, Clone)]
struct BoundGeometric<'a> {
    network: &'a GeometricNetwork,
    known: KnownTokens,
    /// The batch, one row for each sample.
    batch: SceneBatch,
    path: Tensor,
}

impl BoundDenoiser<'_> {
    /// `scaled` states with the motion of observed agents in place of observed states.
    fn moved(&self, scaled: &Tensor) -> Result<Tensor> {
        match &self.observed_motion {
            Some(motion) => scaled + motion,
            None => Ok(scaled.clone()),
        }
    }
}

impl Denoiser for BoundDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let edm = self.edm;
        let sigmas = sigma_rows(sigma)?;
        let rows = |value: &dyn Fn(f64) -> f64| rows_like(sigmas.iter().map(|s| value(*s)).collect(), x);
        let c_noise = rows(&|s| edm.c_noise(s))?.flatten_all()?;
        let x = x.broadcast_mul(&self.latent)?;
        let scaled = x.broadcast_mul(&rows(&|s| edm.c_in(s))?)?;
        let estimate = match &self.network {
            Bound::Scene { network, known, path } => {
                let moved = self.moved(&scaled)?;
                let seen = match path {
                    Some(path) => Tensor::cat(&[&moved, &path.matmul(&scaled)?], 3)?,
                    None => moved,
                };
                let f_x = network.forward(&seen, known, &c_noise)?;
                let skipped = x.broadcast_mul(&rows(&|s| edm.c_skip(s))?)?;
                (skipped + f_x.broadcast_mul(&rows(&|s| edm.c_out(s))?)?)?
            }
            Bound::Geometric(bound) => {
                let BoundGeometric { network, known, batch, path } = &**bound;
                let variance = rows(&|s| s * s)?;
                let factors = ModeFactors::new(batch, &variance)?;
                let skipped = factors.skip(&x)?;
                // Sums of smooth motion are about twice as large as those of white motion.
                let path_of_skipped = (path.matmul(&skipped)? * 0.5)?;
                let seen =
                    Tensor::cat(&[&self.moved(&scaled)?, &path.matmul(&scaled)?, &skipped, &path_of_skipped], 3)?;
                let poses = batch.decode(&skipped.detach())?;
                let f_x = network.forward(&seen, &poses, batch, known, &c_noise)?;
                (skipped + factors.out(&f_x)?)?
            }
        };
        estimate.broadcast_mul(&self.latent)
    }
}

/// The preconditioning of each mode of motion at one noise level a row.
struct ModeFactors<'a> {
    /// U, (B, A, D, T, T).
    modes: &'a Tensor,
    /// w and c_out, (B, A, D, T).
    skip: Tensor,
    out: Tensor,
}

impl<'a> ModeFactors<'a> {
    /// At noise of `variance` σ² (B, 1, 1, 1).
    fn new(batch: &'a SceneBatch, variance: &Tensor) -> Result<Self> {
        let Some(surroundings) = &batch.surroundings else {
            candle_core::bail!("the batch lacks the geometry that surrounds its agents; collate it with `Sight`");
        };
        let of_modes = &surroundings.variances;
        let trusted = of_modes.minimum(SIGMA_DATA * SIGMA_DATA)?;
        let skip = trusted.div(&trusted.broadcast_add(variance)?)?;
        let missed = ((1.0 - &skip)?.sqr()? * of_modes)?;
        let out = (missed + skip.sqr()?.broadcast_mul(variance)?)?.sqrt()?;
        Ok(Self { modes: &surroundings.modes, skip, out })
    }

    /// W x, for `x` (B, A, T, D).
    fn skip(&self, x: &Tensor) -> Result<Tensor> {
        self.scale(x, &self.skip)
    }

    /// Uᵀ c_out U f.
    fn out(&self, f_x: &Tensor) -> Result<Tensor> {
        self.scale(f_x, &self.out)
    }

    fn scale(&self, x: &Tensor, factors: &Tensor) -> Result<Tensor> {
        mode_filter(x, self.modes, factors)
    }
}
