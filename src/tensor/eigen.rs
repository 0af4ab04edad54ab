//! Eigenvalues and eigenvectors of small symmetric matrices.

/// Sweeps after which the rotations stop, converged or not; matrices of a hundred rows need fewer than ten.
const MAX_SWEEPS: usize = 30;

/// The eigenvalues of a symmetric matrix and, row by row, its orthonormal eigenvectors.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Eigen {
    pub(super) values: Vec<f64>,
    pub(super) vectors: Vec<f64>,
}

/// Diagonalizes the symmetric `n` x `n` matrix `a`, given row by row, by cyclic Jacobi rotations (Golub and Van Loan,
/// Matrix Computations, section 8.5). Same input, same bits.
pub(super) fn symmetric_eigen(mut a: Vec<f64>, n: usize) -> Eigen {
    let mut vectors = vec![0.0; n * n];
    (0..n).for_each(|i| vectors[i * n + i] = 1.0);
    let scale: f64 = a.iter().map(|v| v * v).sum::<f64>();
    for _ in 0..MAX_SWEEPS {
        let off: f64 = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i * n + j].powi(2)).sum();
        if off <= 1e-26 * scale {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                rotate(&mut a, &mut vectors, n, p, q);
            }
        }
    }
    Eigen { values: (0..n).map(|i| a[i * n + i]).collect(), vectors }
}

/// The rotation of rows and columns `p` and `q` that makes their common entry zero.
fn rotate(a: &mut [f64], vectors: &mut [f64], n: usize, p: usize, q: usize) {
    let common = a[p * n + q];
    if common == 0.0 {
        return;
    }
    let theta = (a[q * n + q] - a[p * n + p]) / (2.0 * common);
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    for k in 0..n {
        let (x, y) = (a[k * n + p], a[k * n + q]);
        a[k * n + p] = c * x - s * y;
        a[k * n + q] = s * x + c * y;
    }
    for k in 0..n {
        let (x, y) = (a[p * n + k], a[q * n + k]);
        a[p * n + k] = c * x - s * y;
        a[q * n + k] = s * x + c * y;
        let (x, y) = (vectors[p * n + k], vectors[q * n + k]);
        vectors[p * n + k] = c * x - s * y;
        vectors[q * n + k] = s * x + c * y;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_of_the_second_difference_are_the_known_ones() {
        // The matrix of (-1, 2, -1) has eigenvalues 2 - 2 cos(k π / (n + 1)).
        let n = 12;
        let entry = |i: usize, j: usize| match i.abs_diff(j) {
            0 => 2.0,
            1 => -1.0,
            _ => 0.0,
        };
        let a: Vec<f64> = (0..n * n).map(|k| entry(k / n, k % n)).collect();
        let Eigen { mut values, vectors } = symmetric_eigen(a.clone(), n);
        for (row, value) in vectors.chunks(n).zip(&values) {
            for i in 0..n {
                let product: f64 = (0..n).map(|j| a[i * n + j] * row[j]).sum();
                assert!((product - value * row[i]).abs() < 1e-12);
            }
        }
        values.sort_by(f64::total_cmp);
        for (k, value) in values.iter().enumerate() {
            let expected = 2.0 - 2.0 * (std::f64::consts::PI * (k + 1) as f64 / (n + 1) as f64).cos();
            assert!((value - expected).abs() < 1e-12, "{value} {expected}");
        }
    }

    #[test]
    fn diagonal_and_empty_matrices_stay_as_they_are() {
        assert_eq!(symmetric_eigen(vec![3.0, 0.0, 0.0, 1.0], 2).values, [3.0, 1.0]);
        assert!(symmetric_eigen(Vec::new(), 0).values.is_empty());
    }
}
