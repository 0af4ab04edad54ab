//! Exponential moving averages of parameters: which weights does a trained model sample with?

use std::collections::BTreeMap;

use candle_core::{Result, Tensor, bail};

use super::params::Params;

/// A moving average of a model's parameters. Its decay grows from 0.1 towards the nominal one as min(decay,
/// (1 + n) / (10 + n)) after n updates, so that short runs are not dominated by the first, random values.
#[derive(Debug, Clone)]
pub struct Ema {
    decay: f64,
    n_updates: u64,
    tensors: BTreeMap<String, Tensor>,
}

impl Ema {
    /// An average that starts from the present values of `params`.
    ///
    /// # Errors
    /// When the device fails.
    pub fn new(decay: f64, params: &Params) -> Result<Self> {
        let copy = |(name, tensor): (String, Tensor)| Ok((name, tensor.copy()?));
        let tensors = params.tensors().into_iter().map(copy).collect::<Result<_>>()?;
        Ok(Self { decay, n_updates: 0, tensors })
    }

    /// An average taken up from a checkpoint, after `n_updates` updates.
    pub const fn resume(decay: f64, n_updates: u64, tensors: BTreeMap<String, Tensor>) -> Self {
        Self { decay, n_updates, tensors }
    }

    /// Number of updates so far.
    pub const fn n_updates(&self) -> u64 {
        self.n_updates
    }

    /// The averages, by the parameters' names.
    pub const fn tensors(&self) -> &BTreeMap<String, Tensor> {
        &self.tensors
    }

    /// Moves the average towards the present values of `params`.
    ///
    /// # Errors
    /// When `params` are not those that the average was made of.
    pub fn update(&mut self, params: &Params) -> Result<()> {
        self.n_updates += 1;
        let n = self.n_updates as f64;
        let decay = self.decay.min((1.0 + n) / (10.0 + n));
        for (name, var) in params.iter() {
            let Some(average) = self.tensors.get_mut(name) else { bail!("the average has no parameter {name}") };
            *average = ((&*average * decay)? + (var.as_detached_tensor() * (1.0 - decay))?)?;
        }
        Ok(())
    }

    /// Exchanges the averages and the values of `params`: once to evaluate with the averages, once more to go on training.
    ///
    /// # Errors
    /// When `params` are not those that the average was made of.
    pub fn swap(&mut self, params: &mut Params) -> Result<()> {
        let copy = |(name, tensor): (String, Tensor)| Ok((name, tensor.copy()?));
        let values = params.tensors().into_iter().map(copy).collect::<Result<_>>()?;
        params.load(&self.tensors)?;
        self.tensors = values;
        Ok(())
    }
}
