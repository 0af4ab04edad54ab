//! Products of matrices that lie anywhere in slices.

use gemm::Parallelism;
use gemmkit::{MatMut, MatRef, bf16};
use std::borrow::Cow;
use std::cell::RefCell;

/// A matrix inside a slice: entry (i, j) is `data[i * row_stride + j * col_stride]`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Matrix<'a, F = f32> {
    data: &'a [F],
    n_rows: usize,
    n_cols: usize,
    row_stride: usize,
    col_stride: usize,
}

impl<'a, F> Matrix<'a, F> {
    /// The row-major matrix of `data` with rows of `n_cols`.
    pub(super) fn new(data: &'a [F], n_cols: usize) -> Self {
        Self { data, n_rows: data.len() / n_cols.max(1), n_cols, row_stride: n_cols, col_stride: 1 }
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

    /// The same for `gemmkit`.
    fn view(self) -> MatRef<'a, F> {
        MatRef::new(self.data, self.n_rows, self.n_cols, self.row_stride as isize, self.col_stride as isize)
    }

    /// Whether every entry lies in the slice.
    fn is_inside(&self) -> bool {
        let last = self.n_rows.saturating_sub(1) * self.row_stride + self.n_cols.saturating_sub(1) * self.col_stride;
        self.n_rows == 0 || self.n_cols == 0 || last < self.data.len()
    }
}

/// Whether a product replaces or adds to what was there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Into {
    /// dst = ..
    Replace,
    /// dst = dst + ..
    Add,
}

/// dst = [dst +] `scale` · lhs · rhs, with `dst` row-major, on the calling thread: the same values whatever the number of
/// threads.
///
/// # Panics
/// When the dimensions do not fit.
pub(super) fn matmul(dst: &mut [f32], into: Into, scale: f32, lhs: Matrix<'_>, rhs: Matrix<'_>) {
    let (m, n, k) = fitting(dst, &lhs, &rhs);
    #[expect(unsafe_code, reason = "the kernels of the gemm crate take pointers")]
    // SAFETY: all entries of the three matrices lie inside their slices by the assertions of `fitting`, `dst` is row-major and
    // therefore without overlapping entries, and it cannot overlap `lhs` or `rhs` because it is borrowed exclusively.
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
fn fitting<F>(dst: &[f32], lhs: &Matrix<'_, F>, rhs: &Matrix<'_, F>) -> (usize, usize, usize) {
    let (m, n, k) = (lhs.n_rows, rhs.n_cols, lhs.n_cols);
    assert_eq!(k, rhs.n_rows, "inner dimensions differ");
    assert_eq!(dst.len(), m * n, "the product has a different size");
    assert!(lhs.is_inside() && rhs.is_inside(), "a matrix leaves its slice");
    (m, n, k)
}

/// The precision of the factors of products.
pub(super) trait Factors: Send + Sync + 'static {
    /// The type of a factor.
    type Factor: Copy + Default + Send + Sync;

    /// Rows of one task, few enough that their inputs and outputs stay in the cache between product and activation.
    const N_ROWS: usize;

    /// These numbers as factors.
    fn of(values: Cow<'_, [f32]>) -> Cow<'_, [Self::Factor]>;

    /// dst = [dst +] lhs · rhs, as [`matmul`].
    fn product(dst: &mut [f32], into: Into, lhs: Matrix<'_, Self::Factor>, rhs: Matrix<'_, Self::Factor>);
}

/// [`Precision::F32`](crate::nn::Precision::F32).
pub(super) struct F32;

impl Factors for F32 {
    type Factor = f32;
    const N_ROWS: usize = 128;

    fn of(values: Cow<'_, [f32]>) -> Cow<'_, [f32]> {
        values
    }

    fn product(dst: &mut [f32], into: Into, lhs: Matrix<'_>, rhs: Matrix<'_>) {
        matmul(dst, into, 1.0, lhs, rhs);
    }
}

/// [`Precision::Tf32`](crate::nn::Precision::Tf32).
pub(super) struct Tf32;

impl Tf32 {
    /// Tensor cores read only the sign, the exponent and the first ten bits of the fraction.
    const fn cut(value: f32) -> f32 {
        if value.is_nan() { value } else { f32::from_bits(value.to_bits() & !0x1fff) }
    }
}

impl Factors for Tf32 {
    type Factor = f32;
    const N_ROWS: usize = F32::N_ROWS;

    fn of(values: Cow<'_, [f32]>) -> Cow<'_, [f32]> {
        Cow::Owned(values.iter().map(|value| Self::cut(*value)).collect())
    }

    fn product(dst: &mut [f32], into: Into, lhs: Matrix<'_>, rhs: Matrix<'_>) {
        matmul(dst, into, 1.0, lhs, rhs);
    }
}

/// The nearest number of eight bits, ties to even: the rest is rounded in integer arithmetic, and a carry goes to the
/// exponent. As `bf16::from_f32`, without its branches, which cost more than the rounding.
fn nearest_halved(value: f32) -> bf16 {
    if value.is_nan() {
        return bf16::NAN;
    }
    let bits = value.to_bits();
    bf16::from_bits((bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16) as u16)
}

thread_local! {
    /// A buffer for a product before it becomes `f32`, reused so that it need not be cleared.
    static PRODUCT: RefCell<Vec<bf16>> = const { RefCell::new(Vec::new()) };
}

/// [`Precision::Bf16`](crate::nn::Precision::Bf16): products are summed in `f32` and rounded once.
pub(super) struct Bf16;

impl Factors for Bf16 {
    type Factor = bf16;
    /// Each task packs the weights anew; more rows amortize it.
    const N_ROWS: usize = 256;

    fn of(values: Cow<'_, [f32]>) -> Cow<'_, [bf16]> {
        Cow::Owned(values.iter().map(|value| nearest_halved(*value)).collect())
    }

    fn product(dst: &mut [f32], into: Into, lhs: Matrix<'_, bf16>, rhs: Matrix<'_, bf16>) {
        let (m, n, _) = fitting(dst, &lhs, &rhs);
        PRODUCT.with_borrow_mut(|product| {
            if product.len() < m * n {
                product.resize(m * n, bf16::ZERO);
            }
            let product = &mut product[..m * n];
            let target = MatMut::from_row_major(product, m, n);
            gemmkit::gemm(bf16::ONE, lhs.view(), rhs.view(), bf16::ZERO, target, gemmkit::Parallelism::Serial);
            let product = product.iter().map(|value| f32::from_bits(u32::from(value.to_bits()) << 16));
            match into {
                Into::Replace => dst.iter_mut().zip(product).for_each(|(dst, value)| *dst = value),
                Into::Add => dst.iter_mut().zip(product).for_each(|(dst, value)| *dst += value),
            }
        });
    }
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
    fn halved_factors_are_summed_in_full() {
        // 1 + 2⁻⁸ is rounded to 1, and 3 · (1 + 2⁻⁷) needs nine bits; 200 ones are summed exactly, 300 cannot be held.
        let product = |lhs: &[f32], rhs: &[f32], into: Into, dst: f32| {
            let [lhs, rhs] = [lhs, rhs].map(|values| Bf16::of(Cow::Borrowed(values)));
            let mut dst = [dst];
            Bf16::product(&mut dst, into, Matrix::new(&lhs, lhs.len()), Matrix::new(&rhs, 1));
            dst[0]
        };
        assert_eq!(product(&[1.003_906_2], &[1.0], Into::Replace, 7.0), 1.0);
        assert_eq!(product(&[3.0], &[1.007_812_5], Into::Replace, 7.0), 3.031_25);
        assert_eq!(product(&[1.0; 200], &[1.0; 200], Into::Add, 0.001), 200.001);
        assert_eq!(product(&[1.0; 301], &[1.0; 301], Into::Replace, 0.0), 300.0);
        // Rows, columns and transposed matrices as in single precision, where all numbers are small and whole.
        let numbers = |n: usize, step: usize| (0..n).map(|i| ((i * step) % 7) as f32 - 3.0).collect::<Vec<f32>>();
        let (a, b) = (numbers(5 * 9, 3), numbers(9 * 4, 5));
        let (mut single, mut halved) = ([0.0; 20], [0.0; 20]);
        matmul(&mut single, Into::Replace, 1.0, Matrix::new(&a, 9), Matrix::new(&b, 4));
        let [a, b] = [&a, &b].map(|values| Bf16::of(Cow::Borrowed(values)));
        Bf16::product(&mut halved, Into::Replace, Matrix::new(&a, 9), Matrix::new(&b, 4));
        assert_eq!(halved, single);
        let mut transposed = [0.0; 20];
        Bf16::product(&mut transposed, Into::Replace, Matrix::new(&b, 4).t(), Matrix::new(&a, 9).t());
        assert!((0..20).all(|i| transposed[i % 4 * 5 + i / 4] == single[i]));
    }

    #[test]
    fn tensor_cores_drop_thirteen_bits() {
        // 1 + 2⁻¹⁰ is kept, what comes behind it is not; 3 · (1 + 2⁻¹⁰) is summed in full.
        let factors = Tf32::of(Cow::Borrowed(&[1.000_976_6, 1.001_953, -1.001_953, 3.0, f32::INFINITY]));
        assert_eq!(factors.as_ref(), [1.000_976_6, 1.000_976_6, -1.000_976_6, 3.0, f32::INFINITY]);
        assert!(Tf32::cut(f32::NAN).is_nan() && Tf32::cut(f32::from_bits(0x7f80_0001)).is_nan());
        let mut dst = [0.0];
        Tf32::product(&mut dst, Into::Replace, Matrix::new(&factors[3..4], 1), Matrix::new(&factors[..1], 1));
        assert_eq!(dst, [3.002_929_7]);
    }

    #[test]
    fn rounding_is_that_of_the_type() {
        let special = [0.0, -0.0, f32::MAX, f32::MIN_POSITIVE, f32::INFINITY, f32::NEG_INFINITY, 1e-40, 3.402e38];
        let mut rng = crate::seed::Seed(1).rng();
        let drawn = (0..100_000).map(|_| f32::from_bits((rng.uniform() * 4_294_967_296.0) as u32));
        let between = (0..1000u32).map(|i| f32::from_bits(0x3f80_7ffe + i % 4 + ((i / 4) << 16)));
        for value in special.into_iter().chain(drawn.filter(|value| !value.is_nan())).chain(between) {
            assert_eq!(nearest_halved(value).to_bits(), bf16::from_f32(value).to_bits(), "{value}");
        }
        assert!(nearest_halved(f32::NAN).is_nan() && nearest_halved(f32::from_bits(0x7f80_0001)).is_nan());
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
