//! The Adam optimizer with resumable state: how do gradients change parameters?

use std::collections::BTreeMap;

use candle_core::backprop::GradStore;
use candle_core::{DType, Result, Tensor, bail};

use super::ops::{self, AdamStep, Moments};
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

impl Default for Adam {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, n_steps: 0, moments: BTreeMap::new() }
    }
}

impl Adam {
    /// Takes one step with learning rate `lr` and returns the global norm of the gradients before clipping. Gradients
    /// are scaled down together if that norm exceeds `clip_norm`. A parameter without a gradient does not change.
    ///
    /// # Errors
    /// When the norm is not finite; nothing is changed then.
    pub fn step(&mut self, params: &Params, grads: &GradStore, lr: f64, clip_norm: Option<f64>) -> Result<f64> {
        let norm = global_norm(params, grads)?;
        if !norm.is_finite() {
            bail!("the gradient's norm is {norm}: lower the learning rate or look for non-finite inputs");
        }
        let grad_scale = clip_norm.map_or(1.0, |clip| if norm > clip { clip / norm } else { 1.0 });
        self.n_steps += 1;
        let steps = self.n_steps as f64;
        let step = AdamStep {
            grad_scale,
            beta1: self.beta1,
            beta2: self.beta2,
            epsilon: self.epsilon,
            step_size: lr / (1.0 - self.beta1.powf(steps)),
            second_correction: 1.0 / (1.0 - self.beta2.powf(steps)),
        };
        for (name, var) in params.iter() {
            let Some(grad) = grads.get(var.as_tensor()) else { continue };
            if !self.moments.contains_key(name) {
                let zeros = || var.as_detached_tensor().zeros_like();
                self.moments.insert(name.to_owned(), Moments { first: zeros()?, second: zeros()? });
            }
            if let Some(moments) = self.moments.get_mut(name) {
                ops::adam_step(&var.as_detached_tensor(), moments, grad, step)?;
            }
        }
        Ok(norm)
    }

    /// The moments and the number of steps, as tensors for a checkpoint: `first.<parameter>`, `second.<parameter>` and
    /// `n_steps`. They share memory with the optimizer: copy them to keep them beyond the next step.
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

    /// Restores a `state` that [`state`](Self::state) returned for the same `params`.
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
    let grads: Vec<&Tensor> = params.iter().filter_map(|(_, var)| grads.get(var.as_tensor())).collect();
    Ok(ops::sum_of_squares(&grads)?.sqrt())
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Var};

    use super::*;
    use crate::nn::Compute;
    use crate::nn::params::Init;
    use crate::seed::Seed;

    /// Parameters `a` (2) at 1 and `b` (1) at 0.
    fn params(dtype: DType) -> Params {
        let mut params = Params::with_dtype(&Compute::cpu(), dtype);
        params.get_or_init("a", &[2], Init::Ones, Seed(0)).unwrap();
        params.get_or_init("b", &[1], Init::Zeros, Seed(0)).unwrap();
        params
    }

    fn values(params: &Params) -> Vec<f64> {
        let of = |var: &Var| var.as_detached_tensor().to_dtype(DType::F64).unwrap().to_vec1::<f64>().unwrap();
        params.iter().flat_map(|(_, var)| of(var)).collect()
    }

    /// Gradients (3, -4) and 12 times `scale`.
    fn grads(params: &Params, scale: f64) -> GradStore {
        let vars: Vec<&Var> = params.iter().map(|(_, var)| var).collect();
        let slope = Tensor::new(&[3.0, -4.0], &Device::Cpu).unwrap().to_dtype(vars[0].dtype()).unwrap();
        let a = (vars[0].as_tensor() * slope).unwrap().sum_all().unwrap();
        let b = (vars[1].as_tensor() * 12.0).unwrap().sum_all().unwrap();
        ((a + b).unwrap() * scale).unwrap().backward().unwrap()
    }

    #[test]
    fn steps_follow_the_definition() {
        for dtype in [DType::F32, DType::F64] {
            let params = params(dtype);
            let mut adam = Adam::default();
            // Expected values by the algorithm of Kingma & Ba, written out for one number.
            let expected = |start: f64, slope: f64| {
                let (mut x, mut first, mut second) = (start, 0.0, 0.0);
                for t in 1..=5 {
                    let grad = slope * f64::from(t);
                    first = 0.9 * first + 0.1 * grad;
                    second = 0.999 * second + 0.001 * grad * grad;
                    let (first, second) = (first / (1.0 - 0.9f64.powi(t)), second / (1.0 - 0.999f64.powi(t)));
                    x -= 0.1 * first / (second.sqrt() + 1e-8);
                }
                x
            };
            for t in 1..=5 {
                let norm = adam.step(&params, &grads(&params, f64::from(t)), 0.1, None).unwrap();
                assert!((norm - 13.0 * f64::from(t)).abs() < 1e-9, "{norm}");
            }
            for (found, expected) in
                values(&params).iter().zip([expected(1.0, 3.0), expected(1.0, -4.0), expected(0.0, 12.0)])
            {
                assert!((found - expected).abs() < 1e-6, "{dtype:?}: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn clipping_scales_all_gradients_together() {
        // With a large epsilon a step is proportional to the gradient.
        let step = |clip: Option<f64>| {
            let params = params(DType::F32);
            let mut adam = Adam { epsilon: 1e6, ..Adam::default() };
            assert!((adam.step(&params, &grads(&params, 1.0), 1e6, clip).unwrap() - 13.0).abs() < 1e-9);
            let values = values(&params);
            [1.0 - values[0], 1.0 - values[1], -values[2]]
        };
        for (clip, expected) in
            [(None, [3.0, -4.0, 12.0]), (Some(20.0), [3.0, -4.0, 12.0]), (Some(6.5), [1.5, -2.0, 6.0])]
        {
            for (found, expected) in step(clip).iter().zip(expected) {
                assert!((found - expected).abs() < 1e-3, "{clip:?}: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn a_norm_that_is_not_finite_changes_nothing() {
        let params = params(DType::F32);
        let mut adam = Adam::default();
        assert!(adam.step(&params, &grads(&params, f64::NAN), 0.1, Some(5.0)).is_err());
        assert_eq!((values(&params), adam.n_steps), (vec![1.0, 1.0, 0.0], 0));
    }

    #[test]
    fn training_goes_on_from_a_saved_state() {
        let (through, resumed) = (params(DType::F32), params(DType::F32));
        let (mut adam, mut first) = (Adam::default(), Adam::default());
        for t in 1..=4 {
            adam.step(&through, &grads(&through, f64::from(t)), 0.1, Some(20.0)).unwrap();
        }
        for t in 1..=2 {
            first.step(&resumed, &grads(&resumed, f64::from(t)), 0.1, Some(20.0)).unwrap();
        }
        let mut second = Adam::default();
        let state = first.state().unwrap();
        let before = state["first.b"].to_vec1::<f32>().unwrap();
        second.load(&resumed, &state).unwrap();
        for t in 3..=4 {
            second.step(&resumed, &grads(&resumed, f64::from(t)), 0.1, Some(20.0)).unwrap();
        }
        assert_eq!(values(&through), values(&resumed));
        assert_eq!(second.n_steps, 4);
        assert_eq!(state["first.b"].to_vec1::<f32>().unwrap(), before, "the second optimizer works on its own copy");
        let mut other = Params::new(&Compute::cpu());
        other.get_or_init("a", &[3], Init::Ones, Seed(0)).unwrap();
        assert!(Adam::default().load(&other, &first.state().unwrap()).is_err());
    }
}
