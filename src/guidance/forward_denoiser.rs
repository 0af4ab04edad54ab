//! A denoiser in whose clean estimates vehicles do not drive backward.

use crate::diffusion::Denoiser;
use crate::tensor::{LeastProgress, SceneBatch};
use candle_core::{Result, Tensor};

/// The estimates of another denoiser, bounded: who would drive backward stands.
///
/// That is the projection of the estimate onto what vehicles do, as images are clipped to the range of pixels.
pub struct ForwardDenoiser<'a> {
    /// The denoiser.
    pub inner: &'a dyn Denoiser,
    /// The batch that is sampled, one row a sample.
    pub batch: &'a SceneBatch,
    /// Its bounds.
    pub least: &'a LeastProgress,
}

impl Denoiser for ForwardDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        self.least.kept(&self.inner.denoise(x, sigma)?, self.batch)
    }
}
