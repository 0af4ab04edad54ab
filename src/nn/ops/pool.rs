//! The largest of several entries, or 0: how a network pools a set.

use std::sync::OnceLock;

use candle_core::{CpuStorage, CustomOp1, D, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::host::{slice, values};

/// Results that one task computes.
const N_RESULTS: usize = 64;

/// The plain implementation: see [`pool_positive`](super::pool_positive).
pub(super) fn reference(x: &Tensor) -> Result<Tensor> {
    x.relu()?.max(D::Minus2)
}

/// The fused implementation: see [`pool_positive`](super::pool_positive).
pub(super) fn fused(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(FusedPool { chosen: OnceLock::new() })
}

/// (.., K, F) to (.., F).
struct FusedPool {
    /// The entry from which each result was taken, K if none was positive.
    chosen: OnceLock<Vec<u8>>,
}

impl CustomOp1 for FusedPool {
    fn name(&self) -> &'static str {
        "pool_positive"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let x = slice(x, layout)?;
        let [outer @ .., k, f] = layout.dims() else {
            bail!("pool_positive: {:?} is not a shape of sets", layout.dims())
        };
        let (k, f) = (*k, *f);
        if k >= usize::from(u8::MAX) {
            bail!("pool_positive: {k} entries are too many");
        }
        let n: usize = outer.iter().product();
        let (mut y, mut chosen) = (vec![0.0f32; n * f], vec![k as u8; n * f]);
        if k > 0 && f > 0 {
            let results = y.par_chunks_mut(N_RESULTS * f).zip(chosen.par_chunks_mut(N_RESULTS * f));
            results.zip(x.par_chunks(N_RESULTS * k * f)).for_each(|((y, chosen), x)| {
                for ((y, chosen), set) in
                    y.chunks_exact_mut(f).zip(chosen.chunks_exact_mut(f)).zip(x.chunks_exact(k * f))
                {
                    for (i, entry) in set.chunks_exact(f).enumerate() {
                        for ((y, chosen), value) in y.iter_mut().zip(chosen.iter_mut()).zip(entry) {
                            if *value > *y {
                                (*y, *chosen) = (*value, i as u8);
                            }
                        }
                    }
                }
            });
        }
        let _ = self.chosen.set(chosen);
        let shape: Vec<usize> = outer.iter().copied().chain([f]).collect();
        Ok((CpuStorage::F32(y), shape.into()))
    }

    fn bwd(&self, x: &Tensor, _y: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let Some(chosen) = self.chosen.get() else { bail!("pool_positive: there was no forward pass") };
        let grad = grad.contiguous()?;
        let [.., k, f] = x.dims() else { bail!("pool_positive: {:?} is not a shape of sets", x.dims()) };
        let (k, f) = (*k, *f);
        let mut dx = vec![0.0f32; x.elem_count()];
        if k > 0 && f > 0 {
            let grad = values(&grad)?;
            let results = grad.par_chunks(N_RESULTS * f).zip(chosen.par_chunks(N_RESULTS * f));
            dx.par_chunks_mut(N_RESULTS * k * f).zip(results).for_each(|(dx, (grad, chosen))| {
                for ((set, grad), chosen) in
                    dx.chunks_exact_mut(k * f).zip(grad.chunks_exact(f)).zip(chosen.chunks_exact(f))
                {
                    for (j, (grad, chosen)) in grad.iter().zip(chosen).enumerate() {
                        if usize::from(*chosen) < k {
                            set[usize::from(*chosen) * f + j] = *grad;
                        }
                    }
                }
            });
        }
        Tensor::from_vec(dx, x.shape(), x.device()).map(Some)
    }
}
