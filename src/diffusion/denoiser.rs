//! The interface of a network for a sampler: the noisy tensor and its noise level in, the clean estimate out.

use candle_core::{DType, Result, Tensor};

/// An estimate of the clean tensor from a noisy one: D(x; σ) of EDM's equation 1.
///
/// Everything that the estimate is conditioned on is bound inside the implementation.
pub trait Denoiser {
    /// The clean estimate `x0_hat`, with the shape of `x`. `x` is (B, …); `sigma` is (B), one positive noise level per
    /// row, in the same dtype. A row of the result depends on its own row of `x` and `sigma` only.
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor>;
}

/// The noise levels of a (B) tensor on the host.
pub fn sigma_rows(sigma: &Tensor) -> Result<Vec<f64>> {
    sigma.to_dtype(DType::F64)?.to_vec1()
}

/// One value per batch row as a (B, 1, …, 1) tensor that broadcasts against `like` (B, …), in its dtype and on its
/// device.
pub fn rows_like(values: Vec<f64>, like: &Tensor) -> Result<Tensor> {
    let mut dims = vec![1; like.rank()];
    dims[0] = values.len();
    Tensor::from_vec(values, dims, like.device())?.to_dtype(like.dtype())
}
