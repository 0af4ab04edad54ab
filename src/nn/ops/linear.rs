//! Affine map, bias and activation.

use std::borrow::Cow;

use candle_core::{CpuStorage, CustomOp3, D, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::Activation;
use super::gemm::{Into, Matrix, matmul};
use super::host::{gradient, slice, values};
use super::kernels::vectorized;
use super::rows::{gather, spans, valid_rows};
use crate::nn::precision::Precision;

/// Rows of one task, few enough that their inputs and outputs stay in the cache between product and activation, and a
/// multiple of those of the kernels for AVX2 (6) and AVX-512 (8).
const N_ROWS: usize = 120;
/// Rows whose gradients of weights are summed in one product.
const N_SUMMED: usize = 256;
/// Rows of a matrix that are transposed together: one cache line of the result.
const N_TRANSPOSED: usize = 16;
/// Outputs whose weights one task differentiates, or inputs whose weights it transposes.
const N_OUTPUTS: usize = 64;

/// The plain implementation: see [`linear`](super::linear).
pub(super) fn reference(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    activation: Activation,
    valid: Option<&Tensor>,
    precision: Precision,
) -> Result<Tensor> {
    let (n_out, n_in) = weight.dims2()?;
    let mut shape = x.dims().to_vec();
    shape.pop();
    shape.push(n_out);
    let y = precision.product(&x.reshape(((), n_in))?, &weight.t()?)?.broadcast_add(bias)?.reshape(shape)?;
    let y = match activation {
        Activation::None => y,
        Activation::Relu => y.relu()?,
    };
    match valid {
        None => Ok(y),
        Some(valid) => y.broadcast_mul(&valid.unsqueeze(D::Minus1)?),
    }
}

/// The fused implementation: see [`linear`](super::linear).
pub(super) fn fused(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    activation: Activation,
    valid: Option<&Tensor>,
) -> Result<Tensor> {
    let rows = match valid {
        None => (0..(x.elem_count() / x.dim(D::Minus1)?) as u32).collect(),
        Some(valid) => valid_rows(&values(&valid.contiguous()?)?),
    };
    // Weights that are stored transposed stay where they are.
    let weight = if weight.t()?.is_contiguous() { weight.clone() } else { weight.contiguous()? };
    x.contiguous()?.apply_op3(&weight, &bias.contiguous()?, FusedLinear { activation, rows })
}

/// x (.., K), W (N, K), b (N) to (.., N), only on `rows`; the others are 0.
struct FusedLinear {
    activation: Activation,
    rows: Vec<u32>,
}

impl FusedLinear {
    /// The gradient at the output of the affine map, for some rows and the outputs from `first` to `end`.
    fn gradient(&self, y: &[f32], grad: &[f32], rows: &[u32], n_out: usize, first: usize, end: usize) -> Vec<f32> {
        let mut gradient = Vec::with_capacity(rows.len() * (end - first));
        for row in rows {
            let start = *row as usize * n_out;
            let grad = &grad[start + first..start + end];
            match self.activation {
                Activation::None => gradient.extend_from_slice(grad),
                Activation::Relu => {
                    let y = &y[start + first..start + end];
                    gradient.extend(grad.iter().zip(y).map(|(g, y)| if *y > 0.0 { *g } else { 0.0 }));
                }
            }
        }
        gradient
    }

    fn gradient_of_x(&self, y: &[f32], grad: &[f32], weight: Matrix<'_>, [n_in, n_out]: [usize; 2]) -> Vec<f32> {
        let mut dx = vec![0.0; y.len() / n_out * n_in];
        spans(&mut dx, n_in, &self.rows, N_ROWS).par_iter_mut().for_each(|span| {
            let gradient = self.gradient(y, grad, span.rows, n_out, 0, n_out);
            span.write(|dx| {
                matmul(dx, Into::Replace, 1.0, Matrix::new(&gradient, n_out), weight);
            });
        });
        dx
    }

    /// Gradients of weight and bias. Each task sums over all rows in their order, for outputs of its own.
    fn gradient_of_weights(
        &self,
        x: &[f32],
        y: &[f32],
        grad: &[f32],
        n_in: usize,
        n_out: usize,
    ) -> (Vec<f32>, Vec<f32>) {
        let (mut dw, mut db) = (vec![0.0; n_out * n_in], vec![0.0; n_out]);
        // All tasks share the inputs, which are gathered once.
        let shared: Vec<_> = (self.rows.par_chunks(N_SUMMED)).map(|rows| (rows, gather(x, n_in, rows))).collect();
        let tasks = dw.par_chunks_mut(N_OUTPUTS * n_in).zip(db.par_chunks_mut(N_OUTPUTS)).enumerate();
        tasks.for_each(|(task, (dw, db))| {
            let first = task * N_OUTPUTS;
            for (rows, x) in &shared {
                let gradient = self.gradient(y, grad, rows, n_out, first, first + db.len());
                for gradient in gradient.chunks_exact(db.len()) {
                    db.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
                }
                matmul(dw, Into::Add, 1.0, Matrix::new(&gradient, db.len()).t(), Matrix::new(x, n_in));
            }
        });
        (dw, db)
    }
}

impl CustomOp3 for FusedLinear {
    fn name(&self) -> &'static str {
        "linear"
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
        let (x, bias) = (slice(x, x_layout)?, slice(bias, bias_layout)?);
        let (n_out, n_in) = weight_layout.shape().dims2()?;
        let mut shape = x_layout.dims().to_vec();
        shape.pop();
        shape.push(n_out);
        // Otherwise every product would pack its weights anew.
        let weight = match weight_layout.is_contiguous() {
            true => Cow::Owned(transposed(slice(weight, weight_layout)?, n_in)),
            false => Cow::Borrowed(slice(weight, &weight_layout.transpose(0, 1)?)?),
        };
        let mut y = vec![0.0; x.len() / n_in * n_out];
        spans(&mut y, n_out, &self.rows, N_ROWS).par_iter_mut().for_each(|span| {
            let x = gather(x, n_in, span.rows);
            span.write(|y| {
                matmul(y, Into::Replace, 1.0, Matrix::new(&x, n_in), Matrix::new(&weight, n_out));
                vectorized(|| {
                    for y in y.chunks_exact_mut(n_out) {
                        match self.activation {
                            Activation::None => y.iter_mut().zip(bias).for_each(|(y, b)| *y += b),
                            Activation::Relu => y.iter_mut().zip(bias).for_each(|(y, b)| *y = (*y + b).max(0.0)),
                        }
                    }
                });
            });
        });
        Ok((CpuStorage::F32(y), shape.into()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        y: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let grad = grad.contiguous()?;
        let (n_out, n_in) = weight.dims2()?;
        let is_transposed = !weight.is_contiguous();
        let stored = if is_transposed { weight.t()? } else { weight.clone() };
        let (x_values, stored, y_values, grad) = (values(x)?, values(&stored)?, values(y)?, values(&grad)?);
        let (x_slice, y, grad) = (&*x_values, &*y_values, &*grad);
        let weight_matrix = if is_transposed { Matrix::new(&stored, n_out).t() } else { Matrix::new(&stored, n_in) };
        let (dx, dw) = rayon::join(
            || x.track_op().then(|| self.gradient_of_x(y, grad, weight_matrix, [n_in, n_out])),
            || (weight.track_op() || bias.track_op()).then(|| self.gradient_of_weights(x_slice, y, grad, n_in, n_out)),
        );
        let (dw, db) = dw.unzip();
        Ok((gradient(dx, x)?, gradient(dw, weight)?, gradient(db, bias)?))
    }
}

/// The transposed matrix of rows of `n_cols`.
fn transposed(matrix: &[f32], n_cols: usize) -> Vec<f32> {
    let n_rows = matrix.len() / n_cols;
    let mut transposed = vec![0.0; matrix.len()];
    transposed.par_chunks_mut(N_OUTPUTS * n_rows).enumerate().for_each(|(task, columns)| {
        // Sixteen rows at a time, so that writes fill whole cache lines.
        for (block, rows) in matrix.chunks(N_TRANSPOSED * n_cols).enumerate() {
            for (i, column) in columns.chunks_exact_mut(n_rows).enumerate() {
                let j = task * N_OUTPUTS + i;
                let column = &mut column[block * N_TRANSPOSED..][..rows.len() / n_cols];
                for (value, row) in column.iter_mut().zip(rows.chunks_exact(n_cols)) {
                    *value = row[j];
                }
            }
        }
    });
    transposed
}
