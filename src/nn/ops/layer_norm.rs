//! Layer normalization.

use candle_core::{CpuStorage, CustomOp3, D, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{gradient, slice, values};
use super::kernels::{sum, sum_pairs, vectorized};

/// Rows of one task.
const N_ROWS: usize = 128;

/// The plain implementation: see [`layer_norm`](super::layer_norm).
pub(super) fn reference(x: &Tensor, weight: &Tensor, bias: &Tensor, epsilon: f64) -> Result<Tensor> {
    let centered = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
    let variance = centered.sqr()?.mean_keepdim(D::Minus1)?;
    centered.broadcast_div(&(variance + epsilon)?.sqrt()?)?.broadcast_mul(weight)?.broadcast_add(bias)
}

/// The fused implementation: see [`layer_norm`](super::layer_norm).
pub(super) fn fused(x: &Tensor, weight: &Tensor, bias: &Tensor, epsilon: f64) -> Result<Tensor> {
    let op = FusedLayerNorm { epsilon: epsilon as f32 };
    x.contiguous()?.apply_op3(&weight.contiguous()?, &bias.contiguous()?, op)
}

/// x (.., D), weight (D), bias (D) to (.., D).
struct FusedLayerNorm {
    epsilon: f32,
}

impl FusedLayerNorm {
    /// Mean and inverse standard deviation of a row.
    #[inline(always)]
    fn moments(&self, x: &[f32]) -> (f32, f32) {
        let mean = sum(x, |x| x) / x.len() as f32;
        let variance = sum(x, |x| (x - mean) * (x - mean)) / x.len() as f32;
        (mean, 1.0 / (variance + self.epsilon).sqrt())
    }

    /// Gradients of some rows: fills `dx` and returns what the rows add to the gradients of weight and bias.
    #[inline(always)]
    fn backward(&self, dx: &mut [f32], x: &[f32], grad: &[f32], weight: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let dim = weight.len();
        let (mut dw, mut db) = (vec![0.0; dim], vec![0.0; dim]);
        for ((dx, x), grad) in dx.chunks_exact_mut(dim).zip(x.chunks_exact(dim)).zip(grad.chunks_exact(dim)) {
            let (mean, scale) = self.moments(x);
            for ((dw, db), (x, g)) in dw.iter_mut().zip(&mut db).zip(x.iter().zip(grad)) {
                *dw += (x - mean) * scale * g;
                *db += g;
            }
            dx.iter_mut().zip(grad.iter().zip(weight)).for_each(|(dx, (g, w))| *dx = g * w);
            let along_mean = sum(dx, |d| d) / dim as f32;
            let along_x = sum_pairs(dx, x, |d, x| d * ((x - mean) * scale)) / dim as f32;
            for (dx, x) in dx.iter_mut().zip(x) {
                *dx = scale * (*dx - along_mean - (x - mean) * scale * along_x);
            }
        }
        (dw, db)
    }
}

impl CustomOp3 for FusedLayerNorm {
    fn name(&self) -> &'static str {
        "layer_norm"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (x, weight, bias) = (slice(x, x_layout)?, slice(weight, weight_layout)?, slice(bias, bias_layout)?);
        let dim = weight.len();
        let mut y = vec![0.0; x.len()];
        y.par_chunks_mut(N_ROWS * dim).zip(x.par_chunks(N_ROWS * dim)).for_each(|(y, x)| {
            vectorized(|| {
                for (y, x) in y.chunks_exact_mut(dim).zip(x.chunks_exact(dim)) {
                    let (mean, scale) = self.moments(x);
                    for ((y, x), (w, b)) in y.iter_mut().zip(x).zip(weight.iter().zip(bias)) {
                        *y = (x - mean) * scale * w + b;
                    }
                }
            });
        });
        Ok((CpuStorage::F32(y), x_layout.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        _y: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let grad = grad.contiguous()?;
        let dim = weight.elem_count();
        let mut dx = vec![0.0; x.elem_count()];
        let parts: Vec<(Vec<f32>, Vec<f32>)> = {
            let (x, weight, grad) = (values(x)?, values(weight)?, values(&grad)?);
            let tasks = dx.par_chunks_mut(N_ROWS * dim).zip(x.par_chunks(N_ROWS * dim));
            let tasks = tasks.zip(grad.par_chunks(N_ROWS * dim));
            tasks.map(|((dx, x), grad)| vectorized(|| self.backward(dx, x, grad, &weight))).collect()
        };
        // The parts are added in their order, whichever thread made them.
        let (mut dw, mut db) = (vec![0.0; dim], vec![0.0; dim]);
        for (part_dw, part_db) in parts {
            dw.iter_mut().zip(part_dw).for_each(|(sum, part)| *sum += part);
            db.iter_mut().zip(part_db).for_each(|(sum, part)| *sum += part);
        }
        Ok((gradient(Some(dx), x)?, gradient(Some(dw), weight)?, gradient(Some(db), bias)?))
    }
}
