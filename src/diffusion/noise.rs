//! The noise of a batch, drawn so that a sample never depends on the batch that contains it.

use crate::seed::Seed;
use candle_core::{DType, Device, Result, Tensor};
use rayon::prelude::*;

/// Gaussian noise with a stream of its own for every batch row, drawn on the host.
///
/// The k-th draw for a row depends on the row's seed and on k only. Within a row, numbers are assigned in memory order:
/// padding at the end of a row's first axis (absent agents) leaves the noise of everything before it unchanged.
#[derive(Debug, Clone)]
pub struct NoiseSource {
    seeds: Vec<Seed>,
    n_draws: u64,
}

impl NoiseSource {
    /// A source with one seed for each batch row.
    pub const fn new(seeds: Vec<Seed>) -> Self {
        Self { seeds, n_draws: 0 }
    }

    /// Number of batch rows.
    pub const fn n_rows(&self) -> usize {
        self.seeds.len()
    }

    /// Standard normal noise of shape (B, `row_dims`…), where B is the number of seeds.
    pub fn draw(&mut self, row_dims: &[usize], dtype: DType, device: &Device) -> Result<Tensor> {
        let row_len: usize = row_dims.iter().product();
        let mut values = vec![0.0; self.seeds.len() * row_len];
        values.par_chunks_mut(row_len.max(1)).zip(&self.seeds).for_each(|(row, seed)| {
            let mut rng = seed.derive("draw", &[self.n_draws]).rng();
            row.iter_mut().for_each(|value| *value = rng.normal());
        });
        self.n_draws += 1;
        let dims: Vec<usize> = [self.seeds.len()].into_iter().chain(row_dims.iter().copied()).collect();
        // The draws are f64 for any dtype, so that f32 and f64 runs see the same noise.
        Tensor::from_vec(values, dims, &Device::Cpu)?.to_dtype(dtype)?.to_device(device)
    }

    /// Standard normal noise of the shape, dtype and device of `x` (B, …).
    pub fn draw_like(&mut self, x: &Tensor) -> Result<Tensor> {
        let n_rows = x.dim(0)?;
        if n_rows != self.n_rows() {
            candle_core::bail!("{} noise streams were given for a batch of {n_rows} rows", self.n_rows());
        }
        self.draw(&x.dims()[1..], x.dtype(), x.device())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(source: &mut NoiseSource, row_dims: &[usize]) -> Vec<Vec<f64>> {
        source.draw(row_dims, DType::F64, &Device::Cpu).unwrap().flatten_from(1).unwrap().to_vec2().unwrap()
    }

    #[test]
    fn a_row_depends_on_its_own_seed_only() {
        let mut both = NoiseSource::new(vec![Seed(1), Seed(2)]);
        let mut alone = NoiseSource::new(vec![Seed(2)]);
        for _ in 0..3 {
            assert_eq!(draw(&mut both, &[4, 5])[1], draw(&mut alone, &[4, 5])[0]);
        }
    }

    #[test]
    fn padding_at_the_end_changes_nothing_before_it() {
        let (mut narrow, mut wide) = (NoiseSource::new(vec![Seed(9)]), NoiseSource::new(vec![Seed(9)]));
        for _ in 0..3 {
            let (narrow, wide) = (draw(&mut narrow, &[3, 5]), draw(&mut wide, &[7, 5]));
            assert_eq!(narrow[0][..], wide[0][..15]);
        }
    }

    #[test]
    fn successive_draws_differ() {
        let mut source = NoiseSource::new(vec![Seed(9)]);
        assert_ne!(draw(&mut source, &[8]), draw(&mut source, &[8]));
    }

    #[test]
    fn another_number_of_rows_is_an_error() {
        let x = Tensor::zeros((3, 2), DType::F32, &Device::Cpu).unwrap();
        let message = NoiseSource::new(vec![Seed(1)]).draw_like(&x).unwrap_err().to_string();
        assert!(message.contains("1 noise streams") && message.contains("3 rows"), "{message}");
    }
}
