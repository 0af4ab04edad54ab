//! Exponential moving averages of parameters: which weights does a trained model sample with?

use std::collections::BTreeMap;

use candle_core::{Result, Tensor, bail};

use super::ops;
use super::params::Params;

/// A moving average of a model's parameters. Its decay grows from 0.1 toward the nominal one as min(decay,
/// (1 + n) / (10 + n)) after n updates, so that short runs are not dominated by the first, random values.
#[derive(Debug, Clone)]
pub struct Ema {
    decay: f64,
    n_updates: u64,
    tensors: BTreeMap<String, Tensor>,
}

impl Ema {
    /// An average that starts from the present values of `params`.
    pub fn new(decay: f64, params: &Params) -> Result<Self> {
        Ok(Self { decay, n_updates: 0, tensors: copies(&params.tensors())? })
    }

    /// An average restored from a checkpoint, after `n_updates` updates. It works in the memory of `tensors`.
    pub const fn resume(decay: f64, n_updates: u64, tensors: BTreeMap<String, Tensor>) -> Self {
        Self { decay, n_updates, tensors }
    }

    /// Number of updates so far.
    pub const fn n_updates(&self) -> u64 {
        self.n_updates
    }

    /// The averages, by the parameters' names. They change with the next update: copy them to keep them.
    pub const fn tensors(&self) -> &BTreeMap<String, Tensor> {
        &self.tensors
    }

    /// Moves the average toward the present values of `params`.
    ///
    /// # Errors
    /// When `params` are not those from which the average was made.
    pub fn update(&mut self, params: &Params) -> Result<()> {
        self.n_updates += 1;
        let n = self.n_updates as f64;
        let decay = self.decay.min((1.0 + n) / (10.0 + n));
        for (name, var) in params.iter() {
            let Some(average) = self.tensors.get_mut(name) else { bail!("the average has no parameter {name}") };
            ops::average_step(average, &var.as_detached_tensor(), decay)?;
        }
        Ok(())
    }

    /// Swaps the averages and the values of `params`: once to evaluate with the averages, once more to continue
    /// training.
    ///
    /// # Errors
    /// When `params` are not those from which the average was made.
    pub fn swap(&mut self, params: &mut Params) -> Result<()> {
        let values = copies(&params.tensors())?;
        params.load(&self.tensors)?;
        self.tensors = values;
        Ok(())
    }
}

/// Contiguous copies with memory of their own.
pub(crate) fn copies(tensors: &BTreeMap<String, Tensor>) -> Result<BTreeMap<String, Tensor>> {
    tensors.iter().map(|(name, tensor)| Ok((name.clone(), tensor.force_contiguous()?.detach()))).collect()
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;
    use crate::nn::Compute;
    use crate::nn::params::Init;
    use crate::seed::Seed;

    fn set(params: &mut Params, value: f32) {
        params.load(&BTreeMap::from([("a".to_owned(), Tensor::new(&[value, -value], &Device::Cpu).unwrap())])).unwrap();
    }

    fn values(tensors: &BTreeMap<String, Tensor>) -> Vec<f32> {
        tensors["a"].to_vec1().unwrap()
    }

    #[test]
    fn averages_follow_the_parameters() {
        let mut params = Params::new(&Compute::cpu());
        params.get_or_init("a", &[2], Init::Zeros, Seed(0)).unwrap();
        let mut ema = Ema::new(0.5, &params).unwrap();
        set(&mut params, 11.0);
        assert_eq!(values(ema.tensors()), [0.0, 0.0]);
        // The first decay is 2 / 11, the second 3 / 12.
        ema.update(&params).unwrap();
        assert!((values(ema.tensors())[0] - 9.0).abs() < 1e-5);
        ema.update(&params).unwrap();
        assert!((values(ema.tensors())[0] - (0.25 * 9.0 + 0.75 * 11.0)).abs() < 1e-5);
        // From the eighth update on, the decay would be 9 / 18 = 0.5 and stays there.
        for _ in 0..20 {
            ema.update(&params).unwrap();
        }
        set(&mut params, 0.0);
        let mut resumed = Ema::resume(0.5, ema.n_updates(), copies(ema.tensors()).unwrap());
        let before = values(ema.tensors());
        resumed.update(&params).unwrap();
        assert_eq!(values(resumed.tensors()), [before[0] * 0.5, before[1] * 0.5]);
        assert_eq!(values(ema.tensors()), before);
    }

    #[test]
    fn swapping_twice_changes_nothing() {
        let mut params = Params::new(&Compute::cpu());
        params.get_or_init("a", &[2], Init::Ones, Seed(0)).unwrap();
        let mut ema = Ema::new(0.9, &params).unwrap();
        set(&mut params, 4.0);
        ema.swap(&mut params).unwrap();
        assert_eq!((values(&params.tensors()), values(ema.tensors())), (vec![1.0, 1.0], vec![4.0, -4.0]));
        ema.swap(&mut params).unwrap();
        assert_eq!((values(&params.tensors()), values(ema.tensors())), (vec![4.0, -4.0], vec![1.0, 1.0]));
    }
}
