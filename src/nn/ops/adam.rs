//! One pass over a parameter, its gradient and its moments.

use candle_core::{Result, Tensor};
use rayon::prelude::*;

use super::host::{change_values, values};

/// Entries that one task updates.
const N_ENTRIES: usize = 1 << 14;

/// Running means of a parameter's gradient and of its square.
#[derive(Debug, Clone)]
pub(in crate::nn) struct Moments {
    /// First moment: the mean gradient.
    pub(in crate::nn) first: Tensor,
    /// Second moment: the mean square.
    pub(in crate::nn) second: Tensor,
}

/// The parameters of one step of Adam.
#[derive(Debug, Clone, Copy)]
pub(in crate::nn) struct AdamStep {
    /// Factor of the gradient, from clipping.
    pub(in crate::nn) grad_scale: f64,
    /// Decay of the first moment.
    pub(in crate::nn) beta1: f64,
    /// Decay of the second moment.
    pub(in crate::nn) beta2: f64,
    /// Added to the root of the second moment.
    pub(in crate::nn) epsilon: f64,
    /// Learning rate, corrected for the first moment's start at 0.
    pub(in crate::nn) step_size: f64,
    /// Factor that corrects the second moment for its start at 0.
    pub(in crate::nn) second_correction: f64,
}

/// The plain implementation: see [`adam_step`](super::adam_step).
pub(super) fn reference(parameter: &Tensor, moments: &mut Moments, grad: &Tensor, step: AdamStep) -> Result<()> {
    let grad = (grad.detach() * step.grad_scale)?;
    moments.first = ((&moments.first * step.beta1)? + (&grad * (1.0 - step.beta1))?)?;
    moments.second = ((&moments.second * step.beta2)? + (grad.sqr()? * (1.0 - step.beta2))?)?;
    let root = ((&moments.second * step.second_correction)?.sqrt()? + step.epsilon)?;
    let moved = (parameter.detach() - ((&moments.first * step.step_size)? / root)?)?;
    parameter.slice_set(&moved, 0, 0)
}

/// The fused implementation: see [`adam_step`](super::adam_step).
pub(super) fn fused(parameter: &Tensor, moments: &Moments, grad: &Tensor, step: AdamStep) -> Result<()> {
    let grad = grad.contiguous()?;
    let grad = values(&grad)?;
    change_values(parameter, |parameter| {
        change_values(&moments.first, |first| {
            change_values(&moments.second, |second| {
                let tasks = parameter.par_chunks_mut(N_ENTRIES).zip(grad.par_chunks(N_ENTRIES));
                let tasks = tasks.zip(first.par_chunks_mut(N_ENTRIES).zip(second.par_chunks_mut(N_ENTRIES)));
                tasks.for_each(|((parameter, grad), (first, second))| update(parameter, grad, first, second, step));
                Ok(())
            })
        })
    })
}

fn update(parameter: &mut [f32], grad: &[f32], first: &mut [f32], second: &mut [f32], step: AdamStep) {
    let grad_scale = step.grad_scale as f32;
    let (beta1, rest1) = (step.beta1 as f32, (1.0 - step.beta1) as f32);
    let (beta2, rest2) = (step.beta2 as f32, (1.0 - step.beta2) as f32);
    let (step_size, correction, epsilon) = (step.step_size as f32, step.second_correction as f32, step.epsilon as f32);
    for ((parameter, grad), (first, second)) in parameter.iter_mut().zip(grad).zip(first.iter_mut().zip(second)) {
        let grad = grad * grad_scale;
        *first = *first * beta1 + grad * rest1;
        *second = *second * beta2 + grad * grad * rest2;
        *parameter -= *first * step_size / ((*second * correction).sqrt() + epsilon);
    }
}

/// The fused implementation: see [`sum_of_squares`](super::sum_of_squares).
pub(super) fn fused_sum_of_squares(x: &Tensor) -> Result<f64> {
    let x = x.contiguous()?;
    let x = values(&x)?;
    let of_part = |part: &[f32]| part.iter().map(|x| f64::from(*x) * f64::from(*x)).sum::<f64>();
    let parts: Vec<f64> = x.par_chunks(N_ENTRIES).map(of_part).collect();
    Ok(parts.iter().sum())
}

/// The fused implementation: see [`average_step`](super::average_step).
pub(super) fn fused_average_step(average: &Tensor, value: &Tensor, decay: f64) -> Result<()> {
    let value = value.contiguous()?;
    let value = values(&value)?;
    let (decay, rest) = (decay as f32, (1.0 - decay) as f32);
    change_values(average, |average| {
        average.par_chunks_mut(N_ENTRIES).zip(value.par_chunks(N_ENTRIES)).for_each(|(average, value)| {
            average.iter_mut().zip(value).for_each(|(average, value)| *average = *average * decay + value * rest);
        });
        Ok(())
    })
}
