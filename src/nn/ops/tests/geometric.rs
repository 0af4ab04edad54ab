//! Tests of the operations of the geometric network: modes of motion, pools over lanes, features in frames.

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

/// Frames (rows, 4) of random rotations and origins.
fn frames(n: usize, seed: u64) -> Tensor {
    let angle = normal(&[n, 1], seed);
    Tensor::cat(&[angle.cos().unwrap(), angle.sin().unwrap(), normal(&[n, 2], seed + 1)], 1).unwrap()
}

#[test]
fn frame_maps_agree_with_the_plain_ones_and_differences() {
    use FrameMap::{Dual, DualBack, FromCommon, ToCommon};
    let frames = frames(6, 5).reshape((1, 2, 3, 4)).unwrap();
    // Four parts of two heads of five features: a triple and two that stay.
    let map = |a: &[Tensor]| map_frames(&a[0], &frames, 5, &[Dual, ToCommon, FromCommon, DualBack]);
    let x = [normal(&[1, 2, 3, 40], 1)];
    check(&map, &x, "map_frames");
    check_differences(&map, &x, "map_frames");
    let back = map_frames(&map_frames(&x[0], &frames, 5, &[ToCommon]).unwrap(), &frames, 5, &[FromCommon]).unwrap();
    assert_close(&values(&back), &values(&x[0]), 1e-5, "there and back");
    assert!(map_frames(&x[0], &frames.narrow(3, 0, 3).unwrap(), 5, &[ToCommon]).is_err());
}

#[test]
fn products_in_frames_depend_on_how_the_frames_lie_to_each_other() {
    let (queries, keys) = (normal(&[1, 6], 1), normal(&[1, 6], 2));
    let product = |of_query: &Tensor, of_key: &Tensor| {
        let q = map_frames(&queries, of_query, 6, &[FrameMap::Dual]).unwrap();
        let k = map_frames(&keys, of_key, 6, &[FrameMap::ToCommon]).unwrap();
        (q * k).unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap()
    };
    let frame = |angle: f32, x: f32, y: f32| Tensor::new(&[[angle.cos(), angle.sin(), x, y]], &Device::Cpu).unwrap();
    let apart = product(&frame(0.4, 1.0, 2.0), &frame(-0.3, 2.0, 0.5));
    // Both turned by 0.9 about the origin and moved by (-1, 3).
    let moved = |x: f32, y: f32| {
        let (sin, cos) = 0.9f32.sin_cos();
        (cos * x - sin * y - 1.0, sin * x + cos * y + 3.0)
    };
    let ((x1, y1), (x2, y2)) = (moved(1.0, 2.0), moved(2.0, 0.5));
    assert!((product(&frame(1.3, x1, y1), &frame(0.6, x2, y2)) - apart).abs() < 1e-4);
    assert!((product(&frame(1.3, x1, y1), &frame(0.7, x2, y2)) - apart).abs() > 1e-2);
}
