//! Helpers for tests of tensors and networks: values on the host, differences, and gradients that reach every
//! parameter.

use super::Params;
use candle_core::{DType, Tensor};

/// The values of a tensor, in the order of its axes.
pub(crate) fn values(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// The value of a tensor without axes.
pub(crate) fn scalar(tensor: &Tensor) -> f64 {
    tensor.to_dtype(DType::F64).unwrap().to_scalar().unwrap()
}

/// The largest difference between two tensors of the same shape.
#[track_caller]
pub(crate) fn worst(a: &Tensor, b: &Tensor) -> f64 {
    assert_eq!(a.dims(), b.dims());
    values(a).iter().zip(values(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Checks that a loss has a finite gradient, not all zero, in every parameter whose name `is_used`.
#[track_caller]
pub(crate) fn assert_gradients(loss: &Tensor, params: &Params, is_used: impl Fn(&str) -> bool) {
    let gradients = loss.backward().unwrap();
    for (name, var) in params.iter().filter(|(name, _)| is_used(name)) {
        let gradient = values(gradients.get(var.as_tensor()).unwrap_or_else(|| panic!("{name} has no gradient")));
        assert!(gradient.iter().all(|g| g.is_finite()), "the gradient of {name} is not finite");
        assert!(gradient.iter().any(|g| *g != 0.0), "the gradient of {name} is zero");
    }
}
