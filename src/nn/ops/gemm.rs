//! Products of matrices at any place in slices.

use gemm::Parallelism;

/// A matrix inside a slice: entry (i, j) is `data[i * row_stride + j * col_stride]`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Matrix<'a> {
    data: &'a [f32],
    n_rows: usize,
    n_cols: usize,
    row_stride: usize,
    col_stride: usize,
}

impl<'a> Matrix<'a> {
    /// The row-major matrix of `data` with rows of `n_cols`.
    pub(super) fn new(data: &'a [f32], n_cols: usize) -> Self {
        Self { data, n_rows: data.len() / n_cols.max(1), n_cols, row_stride: n_cols, col_stride: 1 }
    }

    /// `n_rows` rows of `n_cols`, one every `row_stride`.
    pub(super) const fn strided(data: &'a [f32], n_rows: usize, n_cols: usize, row_stride: usize) -> Self {
        Self { data, n_rows, n_cols, row_stride, col_stride: 1 }
    }

    /// The transposed matrix, without moving anything.
    pub(super) const fn t(self) -> Self {
        Self {
            data: self.data,
            n_rows: self.n_cols,
            n_cols: self.n_rows,
            row_stride: self.col_stride,
            col_stride: self.row_stride,
        }
    }

    /// Whether every entry lies in the slice.
    fn is_inside(&self) -> bool {
        let last = self.n_rows.saturating_sub(1) * self.row_stride + self.n_cols.saturating_sub(1) * self.col_stride;
        self.n_rows == 0 || self.n_cols == 0 || last < self.data.len()
    }
}

/// Whether a product replaces the destination or is added to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Into {
    /// dst = ..
    Replace,
    /// dst = dst + ..
    Add,
}

/// dst = [dst +] `scale` · lhs · rhs, with `dst` row-major, on the calling thread: the values do not depend on the
/// number of threads.
///
/// # Panics
/// When the dimensions do not fit.
pub(super) fn matmul(dst: &mut [f32], into: Into, scale: f32, lhs: Matrix<'_>, rhs: Matrix<'_>) {
    let (m, n, k) = fitting(dst, &lhs, &rhs);
    #[expect(unsafe_code, reason = "the kernels of the gemm crate take pointers")]
    // SAFETY: all entries of the three matrices lie inside their slices by the assertions of `fitting`, `dst` is
    // row-major and therefore without overlapping entries, and it cannot overlap `lhs` or `rhs` because it is borrowed
    // exclusively.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            dst.as_mut_ptr(),
            1,
            n as isize,
            into == Into::Add,
            lhs.data.as_ptr(),
            lhs.col_stride as isize,
            lhs.row_stride as isize,
            rhs.data.as_ptr(),
            rhs.col_stride as isize,
            rhs.row_stride as isize,
            1.0,
            scale,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

/// Rows, columns and inner dimension of a product that fits.
fn fitting(dst: &[f32], lhs: &Matrix<'_>, rhs: &Matrix<'_>) -> (usize, usize, usize) {
    let (m, n, k) = (lhs.n_rows, rhs.n_cols, lhs.n_cols);
    assert_eq!(k, rhs.n_rows, "inner dimensions differ");
    assert_eq!(dst.len(), m * n, "the product has a different size");
    assert!(lhs.is_inside() && rhs.is_inside(), "a matrix leaves its slice");
    (m, n, k)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_transposed_and_plain_matrices() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let b = [1.0, 0.0, -1.0, 2.0, 1.0, 0.5];
        let mut dst = [100.0; 4];
        // (2, 3) · (3, 2)
        matmul(&mut dst, Into::Replace, 1.0, Matrix::new(&a, 3), Matrix::new(&b, 2));
        assert_eq!(dst, [2.0, 5.5, 5.0, 13.0]);
        // (2, 3) · (2, 3)ᵀ, doubled and added
        matmul(&mut dst, Into::Add, 2.0, Matrix::new(&a, 3), Matrix::new(&b, 3).t());
        assert_eq!(dst, [2.0 - 4.0, 5.5 + 11.0, 5.0 - 4.0, 13.0 + 32.0]);
        // (3, 2) · (2, 3), where the left matrix is stored transposed
        let mut dst = [0.0; 9];
        matmul(&mut dst, Into::Replace, 1.0, Matrix::new(&a, 3).t(), Matrix::new(&b, 3));
        assert_eq!(dst, [9.0, 4.0, 1.0, 12.0, 5.0, 0.5, 15.0, 6.0, 0.0]);
    }

    #[test]
    fn dimensions_are_checked() {
        let product =
            || matmul(&mut [0.0; 4], Into::Replace, 1.0, Matrix::new(&[0.0; 6], 3), Matrix::new(&[0.0; 4], 2));
        let refused = std::panic::catch_unwind(product).unwrap_err();
        let message = refused.downcast_ref::<String>().map_or("", String::as_str);
        assert!(message.contains("inner dimensions differ"), "{message}");
    }
}
