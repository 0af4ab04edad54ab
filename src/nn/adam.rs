//! The Adam optimizer with resumable state: how do gradients change parameters?

use std::collections::BTreeMap;

use candle_core::backprop::GradStore;
use candle_core::{DType, Result, Tensor, bail};

use super::params::Params;

/// Adam (Kingma & Ba 2015) without weight decay, with gradient clipping by global norm.
#[derive(Debug, Clone)]
pub struct Adam {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    n_steps: u64,
    moments: BTreeMap<String, Moments>,
}

/// Running means of one parameter's gradient and of its square.
#[derive(Debug, Clone)]
struct Moments {
    first: Tensor,
    second: Tensor,
}

impl Default for Adam {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, n_steps: 0, moments: BTreeMap::new() }
    }
}

impl Adam {
    /// Number of steps taken.
    pub const fn n_steps(&self) -> u64 {
        self.n_steps
    }

    /// Takes one step with learning rate `lr` and returns the global norm of the gradients before clipping. Gradients are
    /// scaled down together where that norm exceeds `clip_norm`. A parameter without a gradient stays as it is.
    ///
    /// # Errors
    /// When the norm is not finite; nothing is changed then.
    pub fn step(&mut self, params: &Params, grads: &GradStore, lr: f64, clip_norm: Option<f64>) -> Result<f64> {
        let norm = global_norm(params, grads)?;
        if !norm.is_finite() {
            bail!("the gradient's norm is {norm}: lower the learning rate or look for non-finite inputs");
        }
        let scale = clip_norm.map_or(1.0, |clip| if norm > clip { clip / norm } else { 1.0 });
        self.n_steps += 1;
        let steps = self.n_steps as f64;
        let step_size = lr / (1.0 - self.beta1.powf(steps));
        let second_correction = 1.0 / (1.0 - self.beta2.powf(steps));
        for (name, var) in params.iter() {
            let Some(grad) = grads.get(var.as_tensor()) else { continue };
            let moments = match self.moments.get_mut(name) {
                Some(moments) => moments,
                None => self.moments.entry(name.to_owned()).or_insert(Moments {
                    first: var.as_detached_tensor().zeros_like()?,
                    second: var.as_detached_tensor().zeros_like()?,
                }),
            };
            let grad = (grad.detach() * scale)?;
            moments.first = ((&moments.first * self.beta1)? + (&grad * (1.0 - self.beta1))?)?;
            moments.second = ((&moments.second * self.beta2)? + (grad.sqr()? * (1.0 - self.beta2))?)?;
            let root = ((&moments.second * second_correction)?.sqrt()? + self.epsilon)?;
            var.set(&(var.as_detached_tensor() - ((&moments.first * step_size)? / root)?)?)?;
        }
        Ok(norm)
    }

    /// The moments and the number of steps, as tensors for a checkpoint: `first.<parameter>`, `second.<parameter>` and
    /// `n_steps`. They share memory with the optimizer: whoever keeps them beyond the next step copies them.
    ///
    /// # Errors
    /// When the device fails.
    pub fn state(&self) -> Result<BTreeMap<String, Tensor>> {
        let mut state = BTreeMap::new();
        for (name, moments) in &self.moments {
            state.insert(format!("first.{name}"), moments.first.clone());
            state.insert(format!("second.{name}"), moments.second.clone());
        }
        let n_steps = i64::try_from(self.n_steps).map_err(candle_core::Error::wrap)?;
        state.insert("n_steps".to_owned(), Tensor::new(n_steps, &candle_core::Device::Cpu)?);
        Ok(state)
    }

    /// Takes up the `state` that [`state`](Self::state) gave, for the same `params`.
    ///
    /// # Errors
    /// When names or shapes do not fit `params`; nothing is changed then.
    pub fn load(&mut self, params: &Params, state: &BTreeMap<String, Tensor>) -> Result<()> {
        let Some(n_steps) = state.get("n_steps") else { bail!("the optimizer's state has no n_steps") };
        let n_steps = n_steps.to_dtype(DType::I64)?.to_scalar::<i64>()?;
        let mut moments = BTreeMap::new();
        for (name, var) in params.iter() {
            let part = |part: &str| match state.get(&format!("{part}.{name}")) {
                Some(tensor) if tensor.dims() == var.dims() => {
                    tensor.detach().to_device(var.device())?.to_dtype(var.dtype())?.copy().map(Some)
                }
                Some(tensor) => {
                    bail!("the optimizer's {part}.{name} has shape {:?}, not {:?}", tensor.dims(), var.dims())
                }
                None => Ok(None),
            };
            if let (Some(first), Some(second)) = (part("first")?, part("second")?) {
                moments.insert(name.to_owned(), Moments { first, second });
            }
        }
        if state.len() != 2 * moments.len() + 1 {
            bail!("the optimizer's state has moments of parameters that the model does not have");
        }
        self.n_steps = u64::try_from(n_steps).map_err(candle_core::Error::wrap)?;
        self.moments = moments;
        Ok(())
    }
}

/// The Euclidean norm of all gradients together, summed in `f64` in the order of the parameters' names.
fn global_norm(params: &Params, grads: &GradStore) -> Result<f64> {
    let mut sum = 0.0;
    for (_, var) in params.iter() {
        if let Some(grad) = grads.get(var.as_tensor()) {
            sum += grad.detach().to_dtype(DType::F64)?.sqr()?.sum_all()?.to_scalar::<f64>()?;
        }
    }
    Ok(sum.sqrt())
}
