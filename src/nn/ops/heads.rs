//! One attention head on dense matrices: the part that self-attention and cross-attention share.
//!
//! Masked states are left out when queries, keys and values are gathered; no mask is needed here, and padding costs
//! nothing.

use super::gemm::{Into, Matrix, matmul};
use super::kernels::{softmax_rows, softmax_rows_backward};

/// The columns of one head in a row-major matrix.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeadColumns<'a> {
    /// The whole matrix.
    pub(super) data: &'a [f32],
    /// Its row length.
    pub(super) width: usize,
    /// The first column.
    pub(super) first: usize,
    pub(super) n: usize,
}

impl<'a> HeadColumns<'a> {
    /// These columns of the given rows (ascending): where they are if the rows are evenly spaced, otherwise copied to
    /// `dense`.
    pub(super) fn matrix<'b>(self, rows: &[u32], dense: &'b mut Vec<f32>) -> Matrix<'b>
    where
        'a: 'b,
    {
        let step = if let [first, second, ..] = rows { second - first } else { 1 };
        match rows.first() {
            Some(first) if rows.windows(2).all(|pair| pair[1] - pair[0] == step) => {
                let data = &self.data[*first as usize * self.width + self.first..];
                Matrix::strided(data, rows.len(), self.n, step as usize * self.width)
            }
            _ => {
                *dense = self.gather(rows);
                Matrix::new(dense, self.n)
            }
        }
    }

    /// These columns of the given rows, as a dense matrix (rows, n).
    pub(super) fn gather(self, rows: &[u32]) -> Vec<f32> {
        let mut dense = Vec::with_capacity(rows.len() * self.n);
        for row in rows {
            dense.extend_from_slice(&self.data[*row as usize * self.width + self.first..][..self.n]);
        }
        dense
    }
}

/// Scores are divided by √d.
fn scale(head_dim: usize) -> f32 {
    1.0 / (head_dim as f32).sqrt()
}

/// softmax(Q Kᵀ / √d) V for queries (n, d), keys (m, d) and values (m, d), each row of `weights` (n, m) for a row of
/// `n_keys`. Fills `weights` and returns (n, d).
pub(super) fn attend(
    weights: &mut [f32],
    n_keys: usize,
    head_dim: usize,
    [query, key, value]: [Matrix<'_>; 3],
) -> Vec<f32> {
    matmul(weights, Into::Replace, scale(head_dim), query, key.t());
    softmax_rows(weights, n_keys);
    let mut mixed = vec![0.0; weights.len() / n_keys * head_dim];
    matmul(&mut mixed, Into::Replace, 1.0, Matrix::new(weights, n_keys), value);
    mixed
}

/// The gradient at the scores, before their scaling, of [`attend`] with these `weights` (n, m) and values (m, d) if its
/// result has the gradient `grad` (n, d). Fills `grad_scores` (n, m).
pub(super) fn attend_backward(grad_scores: &mut [f32], weights: &[f32], value: &[f32], grad: &[f32], head_dim: usize) {
    let n_keys = value.len() / head_dim;
    matmul(grad_scores, Into::Replace, 1.0, Matrix::new(grad, head_dim), Matrix::new(value, head_dim).t());
    softmax_rows_backward(grad_scores, weights, n_keys, scale(head_dim));
}

/// The product (n, d) of `weights` (n, m) with `dense` (m, d).
pub(super) fn mix(weights: &[f32], dense: &[f32], head_dim: usize) -> Vec<f32> {
    let n_keys = dense.len() / head_dim;
    let mut mixed = vec![0.0; weights.len() / n_keys * head_dim];
    matmul(&mut mixed, Into::Replace, 1.0, Matrix::new(weights, n_keys), Matrix::new(dense, head_dim));
    mixed
}

/// Adds the product (m, d) of transposed `weights` (n, m) with `dense` (n, d) to `sum`.
pub(super) fn add_mixed_back(sum: &mut [f32], weights: &[f32], dense: &[f32], head_dim: usize) {
    let n_keys = sum.len() / head_dim;
    matmul(sum, Into::Add, 1.0, Matrix::new(weights, n_keys).t(), Matrix::new(dense, head_dim));
}

/// Writes a dense matrix into columns of `rows`, from `first` on.
pub(super) fn scatter(rows: &mut [&mut [f32]], first: usize, dense: &[f32]) {
    let n_columns = dense.len() / rows.len().max(1);
    for (row, values) in rows.iter_mut().zip(dense.chunks_exact(n_columns.max(1))) {
        row[first..first + n_columns].copy_from_slice(values);
    }
}
