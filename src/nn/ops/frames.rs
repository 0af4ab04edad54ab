//! Features as coordinates in frames of the plane: products of features in a common frame depend only on the relative
//! pose of their own frames (Miyato et al. 2024, GTA).
//!
//! Each head's features are taken three at a time, as homogeneous coordinates (u, v, w) of the plane; features beyond
//! whole triples stay as they are. A frame g with rotation R and origin t acts on them by ρ(g) = [R t; 0 1].

use candle_core::{CpuStorage, CustomOp1, D, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::host::{slice, values};

/// Coordinates of one triple.
const TRIPLE: usize = 3;

/// A map of triples of features, given the frame of their row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameMap {
    /// ρ: from the row's own frame to the common one.
    ToCommon,
    /// ρ⁻¹: from the common frame to the row's own.
    FromCommon,
    /// ρ⁻ᵀ: for the other factor of products with `ToCommon` features.
    Dual,
    /// ρᵀ: the transpose of `ToCommon`.
    DualBack,
}

impl FrameMap {
    /// The transposed map, which takes gradients back.
    const fn transposed(self) -> Self {
        match self {
            Self::ToCommon => Self::DualBack,
            Self::DualBack => Self::ToCommon,
            Self::FromCommon => Self::Dual,
            Self::Dual => Self::FromCommon,
        }
    }

    /// A triple in a frame [cos, sin, x, y].
    fn of_triple(self, [cos, sin, x, y]: [f32; 4], [u, v, w]: [f32; TRIPLE]) -> [f32; TRIPLE] {
        match self {
            Self::ToCommon => [cos * u - sin * v + x * w, sin * u + cos * v + y * w, w],
            Self::FromCommon => {
                let (u, v) = (u - x * w, v - y * w);
                [cos * u + sin * v, cos * v - sin * u, w]
            }
            Self::Dual => {
                let (u, v) = (cos * u - sin * v, sin * u + cos * v);
                [u, v, w - x * u - y * v]
            }
            Self::DualBack => [cos * u + sin * v, cos * v - sin * u, w + x * u + y * v],
        }
    }

    /// [`Self::of_triple`] for tensors, which broadcast to each other.
    fn of_tensors(self, frame: &[Tensor; 4], [u, v, w]: [Tensor; TRIPLE]) -> Result<[Tensor; TRIPLE]> {
        let [cos, sin, x, y] = frame;
        let times = |a: &Tensor, b: &Tensor| a.broadcast_mul(b);
        let forward = |u: &Tensor, v: &Tensor| -> Result<[Tensor; 2]> {
            Ok([(times(u, cos)? - times(v, sin)?)?, (times(u, sin)? + times(v, cos)?)?])
        };
        let back = |u: &Tensor, v: &Tensor| -> Result<[Tensor; 2]> {
            Ok([(times(u, cos)? + times(v, sin)?)?, (times(v, cos)? - times(u, sin)?)?])
        };
        match self {
            Self::ToCommon => {
                let [u, v] = forward(&u, &v)?;
                Ok([(u + times(&w, x)?)?, (v + times(&w, y)?)?, w])
            }
            Self::FromCommon => {
                let [u, v] = back(&(u - times(&w, x)?)?, &(v - times(&w, y)?)?)?;
                Ok([u, v, w])
            }
            Self::Dual => {
                let [u, v] = forward(&u, &v)?;
                let w = ((w - times(&u, x)?)? - times(&v, y)?)?;
                Ok([u, v, w])
            }
            Self::DualBack => {
                let w = ((w + times(&u, x)?)? + times(&v, y)?)?;
                let [u, v] = back(&u, &v)?;
                Ok([u, v, w])
            }
        }
    }
}

/// The plain implementation: see [`map_frames`](super::map_frames).
pub(super) fn reference(x: &Tensor, frames: &Tensor, head_dim: usize, maps: &[FrameMap]) -> Result<Tensor> {
    let dims = x.dims().to_vec();
    let (n_rows, width) = (x.elem_count() / dims[dims.len() - 1], dims[dims.len() - 1] / maps.len());
    let (n_heads, n_triples) = (width / head_dim, head_dim / TRIPLE);
    let frames = frames.detach().to_dtype(x.dtype())?.reshape((n_rows, 1, 1, 4))?;
    let frame: Vec<Tensor> = (0..4).map(|i| frames.narrow(3, i, 1)).collect::<Result<_>>()?;
    let frame: [Tensor; 4] =
        frame.try_into().map_err(|_| candle_core::Error::Msg("a frame has four numbers".into()))?;
    let part = |(i, map): (usize, &FrameMap)| -> Result<Tensor> {
        let own = x.narrow(D::Minus1, i * width, width)?.reshape((n_rows, n_heads, head_dim))?;
        let triples = own.narrow(2, 0, n_triples * TRIPLE)?.reshape((n_rows, n_heads, n_triples, TRIPLE))?;
        let at = |i: usize| triples.narrow(3, i, 1);
        let mapped = Tensor::cat(&map.of_tensors(&frame, [at(0)?, at(1)?, at(2)?])?, 3)?;
        let rest = own.narrow(2, n_triples * TRIPLE, head_dim - n_triples * TRIPLE)?;
        Tensor::cat(&[mapped.reshape((n_rows, n_heads, n_triples * TRIPLE))?, rest], 2)?.reshape((n_rows, width))
    };
    let parts = maps.iter().enumerate().map(part).collect::<Result<Vec<_>>>()?;
    Tensor::cat(&parts, 1)?.reshape(dims)
}

/// The fused implementation: see [`map_frames`](super::map_frames).
pub(super) fn fused(x: &Tensor, frames: &Tensor, head_dim: usize, maps: &[FrameMap]) -> Result<Tensor> {
    let op = FusedFrames { frames: frames.detach().contiguous()?, head_dim, maps: maps.to_vec() };
    x.contiguous()?.apply_op1(op)
}

struct FusedFrames {
    /// (.., 4).
    frames: Tensor,
    head_dim: usize,
    /// One for each part of a row.
    maps: Vec<FrameMap>,
}

impl FusedFrames {
    fn apply(&self, x: &[f32], maps: &[FrameMap], row: usize) -> Result<Vec<f32>> {
        let frames = values(&self.frames)?;
        let mut y = x.to_vec();
        y.par_chunks_mut(row).zip(frames.par_chunks(4)).with_min_len(64).for_each(|(row, frame)| {
            let frame = [frame[0], frame[1], frame[2], frame[3]];
            let width = row.len() / maps.len();
            for (part, map) in row.chunks_mut(width).zip(maps) {
                for head in part.chunks_mut(self.head_dim) {
                    for triple in head.chunks_exact_mut(TRIPLE) {
                        triple.copy_from_slice(&map.of_triple(frame, [triple[0], triple[1], triple[2]]));
                    }
                }
            }
        });
        Ok(y)
    }
}

impl CustomOp1 for FusedFrames {
    fn name(&self) -> &'static str {
        "map_frames"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let row = layout.shape().dims().last().copied().unwrap_or(1);
        Ok((CpuStorage::F32(self.apply(slice(x, layout)?, &self.maps, row)?), layout.shape().clone()))
    }

    fn bwd(&self, x: &Tensor, _y: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let maps: Vec<FrameMap> = self.maps.iter().map(|map| map.transposed()).collect();
        let dx = self.apply(&values(&grad.contiguous()?)?, &maps, x.dim(D::Minus1)?)?;
        Tensor::from_vec(dx, x.shape(), x.device()).map(Some)
    }
}
