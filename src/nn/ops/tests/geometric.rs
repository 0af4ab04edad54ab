//! Tests of the operations of the geometric network: modes of motion, pools over lanes.

use super::*;

#[test]
fn mode_filters_agree_with_matrix_products_and_differences() {
    // One mode of each agent and dimension is missing.
    let gains = (normal(&[2, 3, 2, 5], 2) * mask(&[2, 3, 2, 5], 0.8, 3)).unwrap();
    let modes = normal(&[2, 3, 2, 5, 5], 4);
    let filter = |a: &[Tensor]| {
        let like = |t: &Tensor| t.to_dtype(a[0].dtype());
        mode_filter(&a[0], &like(&modes)?, &like(&gains)?)
    };
    let x = [normal(&[2, 3, 5, 2], 1)];
    check(&filter, &x, "mode_filter");
    check_differences(&filter, &x, "mode_filter");
}

#[test]
fn pools_agree_with_the_plain_maximum_and_differences() {
    let pool = |a: &[Tensor]| pool_positive(&a[0]);
    let x = [normal(&[3, 4, 6, 5], 1)];
    check(&pool, &x, "pool_positive");
    check_differences(&pool, &x, "pool_positive");
    let negative = (x[0].abs().unwrap() * -1.0).unwrap();
    assert!(values(&pool_positive(&negative).unwrap()).iter().all(|y| *y == 0.0));
}
