//! Sines and cosines of numbers at many frequencies.

use std::f64::consts::TAU;

use candle_core::{CpuStorage, CustomOp1, D, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{slice, values};
use super::kernels::{sin_cos_of_cycles, sum_pairs, vectorized};

/// Numbers that one task encodes.
const N_NUMBERS: usize = 64;

/// The plain implementation: see [`sinusoidal`](super::sinusoidal).
pub(super) fn reference(x: &Tensor, frequencies: &[f64]) -> Result<Tensor> {
    let angular: Vec<f64> = frequencies.iter().map(|f| f * TAU).collect();
    let angular = Tensor::new(angular, x.device())?.to_dtype(x.dtype())?;
    let angles = x.unsqueeze(D::Minus1)?.broadcast_mul(&angular)?;
    Tensor::cat(&[angles.sin()?, angles.cos()?], D::Minus1)
}

/// The fused implementation: see [`sinusoidal`](super::sinusoidal).
pub(super) fn fused(x: &Tensor, frequencies: &[f64]) -> Result<Tensor> {
    x.contiguous()?.apply_op1(FusedSinusoidal { frequencies: frequencies.to_vec() })
}

/// x (..) to (.., 2 · frequencies).
struct FusedSinusoidal {
    frequencies: Vec<f64>,
}

impl CustomOp1 for FusedSinusoidal {
    fn name(&self) -> &'static str {
        "sinusoidal"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let x = slice(x, layout)?;
        let n = self.frequencies.len();
        let mut y = vec![0.0; x.len() * 2 * n];
        y.par_chunks_mut(N_NUMBERS * 2 * n).zip(x.par_chunks(N_NUMBERS)).for_each(|(y, x)| {
            vectorized(|| {
                for (y, x) in y.chunks_exact_mut(2 * n).zip(x) {
                    let (sines, cosines) = y.split_at_mut(n);
                    for ((sin, cos), f) in sines.iter_mut().zip(cosines).zip(&self.frequencies) {
                        (*sin, *cos) = sin_cos_of_cycles(f64::from(*x) * f);
                    }
                }
            });
        });
        let mut shape = layout.dims().to_vec();
        shape.push(2 * n);
        Ok((CpuStorage::F32(y), shape.into()))
    }

    fn bwd(&self, x: &Tensor, y: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let grad = grad.contiguous()?;
        let n = self.frequencies.len();
        let angular: Vec<f32> = self.frequencies.iter().map(|f| (f * TAU) as f32).collect();
        let mut dx = vec![0.0; x.elem_count()];
        {
            let (y, grad) = (values(y)?, values(&grad)?);
            let width = N_NUMBERS * 2 * n;
            let tasks = dx.par_chunks_mut(N_NUMBERS).zip(y.par_chunks(width)).zip(grad.par_chunks(width));
            tasks.for_each(|((dx, y), grad)| {
                let mut scaled = vec![0.0; n];
                for ((dx, y), grad) in dx.iter_mut().zip(y.chunks_exact(2 * n)).zip(grad.chunks_exact(2 * n)) {
                    let ((sin, cos), (grad_sin, grad_cos)) = (y.split_at(n), grad.split_at(n));
                    scaled.iter_mut().zip(&angular).zip(grad_sin).for_each(|((s, f), g)| *s = f * g);
                    *dx = sum_pairs(&scaled, cos, |g, cos| g * cos);
                    scaled.iter_mut().zip(&angular).zip(grad_cos).for_each(|((s, f), g)| *s = f * g);
                    *dx -= sum_pairs(&scaled, sin, |g, sin| g * sin);
                }
            });
        }
        Tensor::from_vec(dx, x.shape(), x.device()).map(Some)
    }
}
