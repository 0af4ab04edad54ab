//! A denoiser that is not asked twice for the estimates of runs that begin alike.

use crate::diffusion::Denoiser;
use candle_core::{Result, Tensor};
use std::cell::{Cell, RefCell};

/// The estimates of another denoiser, for several runs of a sampler: as long as a run passes through the states of the
/// first one, it takes the estimates of that.
///
/// All strengths of guidance begin from the same noise, and guidance acts below some noise level only; above it, their
/// states are the same to the bit.
pub struct RememberingDenoiser<'a> {
    inner: &'a dyn Denoiser,
    /// State (B, A, T, D), noise levels (B) and estimate (B, A, T, D) of each evaluation of the first run.
    first: RefCell<Vec<[Tensor; 3]>>,
    /// The number of the evaluation, while the run is like the first one.
    next: Cell<Option<usize>>,
    is_first: Cell<bool>,
}

impl<'a> RememberingDenoiser<'a> {
    /// Remembers the estimates of `inner`.
    pub const fn new(inner: &'a dyn Denoiser) -> Self {
        Self { inner, first: RefCell::new(Vec::new()), next: Cell::new(Some(0)), is_first: Cell::new(true) }
    }

    /// Begins another run.
    pub fn begin_again(&self) {
        self.is_first.set(false);
        self.next.set(Some(0));
    }
}

impl Denoiser for RememberingDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        if self.is_first.get() {
            let estimate = self.inner.denoise(x, sigma)?;
            self.first.borrow_mut().push([x.detach(), sigma.detach(), estimate.detach()]);
            return Ok(estimate);
        }
        if let Some(at) = self.next.take()
            && let Some([known_x, known_sigma, estimate]) = self.first.borrow().get(at)
            && are_equal(x, known_x)?
            && are_equal(sigma, known_sigma)?
        {
            self.next.set(Some(at + 1));
            return Ok(estimate.clone());
        }
        self.inner.denoise(x, sigma)
    }
}

fn are_equal(a: &Tensor, b: &Tensor) -> Result<bool> {
    Ok(a.dims() == b.dims() && a.eq(b)?.flatten_all()?.to_vec1::<u8>()?.iter().all(|equal| *equal == 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffusion::SamplerConfig;
    use candle_core::Device;

    /// Estimates half of x, and counts.
    struct Half(Cell<usize>);

    impl Denoiser for Half {
        fn denoise(&self, x: &Tensor, _: &Tensor) -> Result<Tensor> {
            self.0.set(self.0.get() + 1);
            x * 0.5
        }
    }

    /// Shifts estimates at noise levels up to 1.
    struct Shifted<'a>(&'a dyn Denoiser, f64);

    impl Denoiser for Shifted<'_> {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            let shift = sigma.le(1.0)?.to_dtype(x.dtype())? * self.1;
            self.0.denoise(x, sigma)?.broadcast_add(&shift?.unsqueeze(1)?)
        }
    }

    #[test]
    fn runs_share_their_beginning_and_differ_as_if_each_were_alone() {
        let run = |denoiser: &dyn Denoiser, shift: f64| {
            let x = Tensor::new(&[[8.0f32, -3.0], [1.0, 0.5]], &Device::Cpu).unwrap();
            let sigmas = [8.0, 4.0, 2.0, 1.0, 0.5, 0.0];
            let shifted = Shifted(denoiser, shift);
            let x = SamplerConfig::dpmpp_2m(5).integrate(&sigmas, &shifted, x, &mut |_| {}).unwrap();
            x.to_vec2::<f32>().unwrap()
        };
        let half = Half(Cell::new(0));
        let remembering = RememberingDenoiser::new(&half);
        for (shift, n_evaluated) in [(0.0, 5), (2.0, 6), (0.0, 6), (-1.0, 7)] {
            assert_eq!(run(&remembering, shift), run(&Half(Cell::new(0)), shift));
            assert_eq!(half.0.get(), n_evaluated, "after a shift of {shift}");
            remembering.begin_again();
        }
    }
}
