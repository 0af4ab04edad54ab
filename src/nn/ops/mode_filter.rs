//! Uᵀ g U x: each mode of an agent's states along time scaled by a factor of its own.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{slice, values};
use super::kernels::{sum_pairs, vectorized};

/// The plain implementation: see [`mode_filter`](super::mode_filter).
pub(super) fn reference(x: &Tensor, modes: &Tensor, gains: &Tensor) -> Result<Tensor> {
    let (b, a, t, d) = x.dims4()?;
    let modes = modes.flatten(0, 2)?;
    let along = modes.matmul(&x.transpose(2, 3)?.reshape((b * a * d, t, 1))?)?;
    let scaled = along.reshape((b, a, d, t))?.mul(gains)?;
    // Multiplying a row from the left avoids transposing the modes.
    let back = scaled.reshape((b * a * d, 1, t))?.matmul(&modes)?;
    back.reshape((b, a, d, t))?.transpose(2, 3)?.contiguous()
}

/// The fused implementation: see [`mode_filter`](super::mode_filter).
pub(super) fn fused(x: &Tensor, modes: &Tensor, gains: &Tensor) -> Result<Tensor> {
    let op = FusedModeFilter { modes: modes.detach().contiguous()?, gains: gains.detach().contiguous()? };
    x.contiguous()?.apply_op1(op)
}

/// (B, A, T, D) to the same shape. The map is symmetric: its own transpose serves the backward pass.
struct FusedModeFilter {
    modes: Tensor,
    gains: Tensor,
}

impl FusedModeFilter {
    fn apply(&self, x: &[f32], dims: &[usize]) -> Result<Vec<f32>> {
        let [_, _, t, d] = *dims else { candle_core::bail!("mode_filter: {dims:?} is not a shape of states") };
        let (modes, gains) = (values(&self.modes)?, values(&self.gains)?);
        let mut y = vec![0.0f32; x.len()];
        let agents = y.par_chunks_mut(t * d).zip(x.par_chunks(t * d));
        agents.zip(modes.par_chunks(d * t * t)).zip(gains.par_chunks(d * t)).for_each(|(((y, x), modes), gains)| {
            let (mut column, mut filtered) = (vec![0.0f32; t], vec![0.0f32; t]);
            vectorized(|| {
                for dim in 0..d {
                    (0..t).for_each(|i| column[i] = x[i * d + dim]);
                    filtered.fill(0.0);
                    for mode in 0..t {
                        let gain = gains[dim * t + mode];
                        if gain == 0.0 {
                            continue;
                        }
                        let mode = &modes[(dim * t + mode) * t..(dim * t + mode + 1) * t];
                        let share = sum_pairs(mode, &column, |u, x| u * x) * gain;
                        filtered.iter_mut().zip(mode).for_each(|(y, u)| *y += share * u);
                    }
                    (0..t).for_each(|i| y[i * d + dim] = filtered[i]);
                }
            });
        });
        Ok(y)
    }
}

impl CustomOp1 for FusedModeFilter {
    fn name(&self) -> &'static str {
        "mode_filter"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        Ok((CpuStorage::F32(self.apply(slice(x, layout)?, layout.dims())?), layout.shape().clone()))
    }

    fn bwd(&self, x: &Tensor, _y: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let grad = grad.contiguous()?;
        let dx = self.apply(&values(&grad)?, grad.dims())?;
        Tensor::from_vec(dx, x.shape(), x.device()).map(Some)
    }
}
