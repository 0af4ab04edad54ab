//! The fused operations against the plain ones in double precision, and the plain ones against finite differences.

mod geometric;

use candle_core::{DType, Device, Result, Tensor, Var};

use super::*;
use crate::nn::testing::values;
use crate::seed::Seed;

/// An operation under test: arguments that get gradients to a result.
pub(super) type Op<'a> = &'a dyn Fn(&[Tensor]) -> Result<Tensor>;

pub(super) fn normal(shape: &[usize], seed: u64) -> Tensor {
    let mut rng = Seed(seed).rng();
    let n = shape.iter().product();
    let values: Vec<f32> = (0..n).map(|_| rng.normal() as f32).collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

/// A mask that keeps each entry with probability `share`.
pub(super) fn mask(shape: &[usize], share: f64, seed: u64) -> Tensor {
    let mut rng = Seed(seed).rng();
    let n = shape.iter().product();
    let values: Vec<f32> = (0..n).map(|_| f32::from(u8::from(rng.uniform() < share))).collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

/// Result and gradients of Σ result · fixed random numbers, computed in `dtype`: `f32` takes the fused implementation,
/// `f64` the plain one.
pub(super) fn run(op: Op<'_>, arguments: &[Tensor], dtype: DType) -> Vec<Vec<f64>> {
    let vars: Vec<Var> =
        arguments.iter().map(|argument| Var::from_tensor(&argument.to_dtype(dtype).unwrap()).unwrap()).collect();
    let tensors: Vec<Tensor> = vars.iter().map(|var| var.as_tensor().clone()).collect();
    let result = op(&tensors).unwrap();
    let weights = normal(result.dims(), 99).to_dtype(dtype).unwrap();
    let grads = (&result * weights).unwrap().sum_all().unwrap().backward().unwrap();
    let mut all = vec![values(&result)];
    all.extend(tensors.iter().map(|tensor| values(grads.get(tensor).unwrap())));
    all
}

pub(super) fn assert_close(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let size = expected.iter().fold(1e-3, |max: f64, v| max.max(v.abs()));
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (found - expected).abs() / size;
        assert!(error <= tolerance, "{what}, entry {i}: {found} instead of {expected} (relative error {error:e})");
    }
}

/// Values and gradients of the fused operation agree with the plain one.
pub(super) fn check(op: Op<'_>, arguments: &[Tensor], what: &str) {
    let (fused, plain) = (run(op, arguments, DType::F32), run(op, arguments, DType::F64));
    for (i, (fused, plain)) in fused.iter().zip(&plain).enumerate() {
        assert_close(fused, plain, 1e-5, &format!("{what}, {}", if i == 0 { "result" } else { "gradient" }));
    }
}

/// The plain operation's gradients agree with central differences.
fn check_differences(op: Op<'_>, arguments: &[Tensor], what: &str) {
    const STEP: f64 = 1e-6;
    let gradients = run(op, arguments, DType::F64);
    let result_at = |moved: usize, entry: usize, by: f64| {
        let arguments: Vec<Tensor> = (arguments.iter().enumerate())
            .map(|(i, argument)| {
                let mut all = values(argument);
                if i == moved {
                    all[entry] += by;
                }
                Tensor::from_vec(all, argument.dims(), &Device::Cpu).unwrap()
            })
            .collect();
        let result = op(&arguments).unwrap();
        let weights = normal(result.dims(), 99).to_dtype(DType::F64).unwrap();
        (result * weights).unwrap().sum_all().unwrap().to_scalar::<f64>().unwrap()
    };
    for (i, argument) in arguments.iter().enumerate() {
        let differences: Vec<f64> = (0..argument.elem_count())
            .map(|entry| (result_at(i, entry, STEP) - result_at(i, entry, -STEP)) / (2.0 * STEP))
            .collect();
        assert_close(&gradients[i + 1], &differences, 1e-6, &format!("{what}, argument {i}"));
    }
}

#[test]
fn linear_agrees() {
    for activation in [Activation::None, Activation::Relu] {
        // More rows than a task takes, and more outputs than one differentiates.
        for (rows, n_in, n_out) in [(vec![2, 3, 50], 20, 70), (vec![1], 7, 3), (vec![129], 1, 1)] {
            let shape: Vec<usize> = rows.iter().copied().chain([n_in]).collect();
            let arguments = [normal(&shape, 1), normal(&[n_out, n_in], 2), normal(&[n_out], 3)];
            let masks = [None, Some(0.0), Some(0.6), Some(1.0)];
            for share in masks {
                let valid = share.map(|share| mask(&rows, share, 4));
                let apply =
                    |a: &[Tensor], w: &Tensor| linear(&a[0], w, &a[2], activation, valid.as_ref(), Precision::F32);
                check(&|a| apply(a, &a[1]), &arguments, &format!("{rows:?} {share:?}"));
                let stored = |w: &Tensor| w.t()?.contiguous()?.t();
                check(&|a| apply(a, &stored(&a[1])?), &arguments, &format!("{rows:?} {share:?}, transposed"));
                let [plain, transposed] = [arguments[1].clone(), stored(&arguments[1]).unwrap()];
                let found = values(&apply(&arguments, &plain).unwrap());
                assert_eq!(found, values(&apply(&arguments, &transposed).unwrap()));
            }
        }
        let arguments = [normal(&[3, 4], 1), normal(&[2, 4], 2), normal(&[2], 3)];
        let valid = Tensor::new(&[1f32, 0.0, 1.0], &Device::Cpu).unwrap();
        check_differences(
            &|a| linear(&a[0], &a[1], &a[2], activation, Some(&valid), Precision::F32),
            &arguments,
            "linear",
        );
    }
}

#[test]
fn layer_norm_agrees() {
    for dims in [&[2, 3, 50, 24][..], &[1, 128], &[7]] {
        let dim = dims[dims.len() - 1];
        let arguments = [normal(dims, 1), normal(&[dim], 2), normal(&[dim], 3)];
        check(&|a| layer_norm(&a[0], &a[1], &a[2], 1e-5), &arguments, &format!("{dims:?}"));
    }
    let arguments = [normal(&[2, 5], 1), normal(&[5], 2), normal(&[5], 3)];
    check_differences(&|a| layer_norm(&a[0], &a[1], &a[2], 1e-5), &arguments, "layer_norm");
    // Padding is often constant: its variance is 0.
    let constant = [Tensor::ones((2, 8), DType::F32, &Device::Cpu).unwrap(), normal(&[8], 2), normal(&[8], 3)];
    check(&|a| layer_norm(&a[0], &a[1], &a[2], 1e-5), &constant, "constant rows");
}

/// A mask (3, 5, 6) with an agent, a timestep and a whole scene of padding.
pub(super) fn padded_states() -> Tensor {
    let mut valid = values(&mask(&[3, 5, 6], 0.7, 5));
    for (i, valid) in valid.iter_mut().enumerate() {
        let (batch, agent, timestep) = (i / 30, i / 6 % 5, i % 6);
        if batch == 2 || agent == 1 || timestep == 4 {
            *valid = 0.0;
        }
    }
    Tensor::from_vec(valid, (3, 5, 6), &Device::Cpu).unwrap().to_dtype(DType::F32).unwrap()
}

#[test]
fn self_attention_agrees() {
    for axis in [Axis::Time, Axis::Agent] {
        let arguments = [normal(&[3, 5, 6, 3 * 16], 1)];
        for valid in [padded_states(), mask(&[3, 5, 6], 1.0, 0), mask(&[3, 5, 6], 0.0, 0)] {
            check(&|a| self_attention(&a[0], &valid, 2, axis), &arguments, &format!("{axis:?}"));
        }
        let valid = Tensor::new(&[[[1f32, 0.0, 1.0], [1.0, 1.0, 1.0]]], &Device::Cpu).unwrap();
        check_differences(
            &|a| self_attention(&a[0], &valid, 2, axis),
            &[normal(&[1, 2, 3, 12], 1)],
            &format!("{axis:?}"),
        );
    }
}

#[test]
fn self_attention_reads_along_its_axis_only() {
    // The result for one state depends on the values of those that it attends to: same agent, or same timestep.
    let valid = mask(&[1, 3, 4], 1.0, 0);
    for (axis, attended) in [(Axis::Time, [4, 5, 6, 7]), (Axis::Agent, [1, 5, 9, usize::MAX])] {
        let qkv = Var::from_tensor(&normal(&[1, 3, 4, 6], 1)).unwrap();
        let mixed = self_attention(qkv.as_tensor(), &valid, 1, axis).unwrap();
        // State 5 is agent 1 at timestep 1.
        let one = mixed.reshape((12, 2)).unwrap().narrow(0, 5, 1).unwrap().sum_all().unwrap();
        let grads = one.backward().unwrap();
        let grad = grads.get(qkv.as_tensor()).unwrap().reshape((12, 6)).unwrap().to_vec2::<f32>().unwrap();
        for (state, grad) in grad.iter().enumerate() {
            assert_eq!(grad.iter().any(|g| *g != 0.0), attended.contains(&state), "{axis:?}, state {state}");
        }
    }
}

#[test]
fn cross_attention_agrees() {
    let valid = padded_states().repeat((2, 1, 1)).unwrap();
    // As many maps as batch rows, maps each shared by some of them, and one map for all.
    for n_maps in [6, 3, 2, 1] {
        for share in [0.6, 1.0, 0.0] {
            let mut lane_valid = mask(&[n_maps, 7], share, 6);
            if n_maps > 2 {
                // One scene without any lane.
                lane_valid = lane_valid.slice_assign(&[1..2, 0..7], &mask(&[1, 7], 0.0, 0)).unwrap();
            }
            let arguments = [normal(&[6, 5, 6, 16], 1), normal(&[n_maps, 7, 32], 2)];
            check(&|a| cross_attention(&a[0], &valid, &a[1], &lane_valid, 2), &arguments, &format!("{n_maps} {share}"));
        }
    }
    let (valid, lanes) = (mask(&[2, 1, 3], 0.7, 1), Tensor::new(&[[1f32, 0.0, 1.0]], &Device::Cpu).unwrap());
    let arguments = [normal(&[2, 1, 3, 4], 1), normal(&[1, 3, 8], 2)];
    check_differences(&|a| cross_attention(&a[0], &valid, &a[1], &lanes, 2), &arguments, "cross_attention");
}

#[test]
fn a_shared_map_is_as_good_as_its_copies() {
    let (query, valid) = (normal(&[4, 2, 3, 8], 1), mask(&[4, 2, 3], 0.8, 2));
    let (keys, lanes) = (normal(&[2, 5, 16], 3), mask(&[2, 5], 0.8, 4));
    let copies = |x: &Tensor| Tensor::stack(&[x, x], 1).unwrap().flatten(0, 1).unwrap();
    let shared = cross_attention(&query, &valid, &keys, &lanes, 2).unwrap();
    let copied = cross_attention(&query, &valid, &copies(&keys), &copies(&lanes), 2).unwrap();
    assert_eq!(values(&shared), values(&copied));
}

#[test]
fn sinusoidal_agrees() {
    let frequencies = [100.0, 7.3, 0.1];
    check(&|a| sinusoidal(&a[0], &frequencies), &[normal(&[3, 50], 1)], "sinusoidal");
    check_differences(&|a| sinusoidal(&a[0], &[2.0, 0.3]), &[normal(&[3], 1)], "sinusoidal");
}

#[test]
fn padding_gives_exactly_zero_and_is_never_read() {
    let valid = padded_states();
    // Whatever padding holds, even NaN, reaches neither results nor gradients of valid states.
    let poison = |x: Tensor| {
        let keep = valid.unsqueeze(3).unwrap().broadcast_as(x.shape()).unwrap().ne(0.0).unwrap();
        keep.where_cond(&x, &Tensor::full(f32::NAN, x.shape(), &Device::Cpu).unwrap()).unwrap()
    };
    let (x, keys, lanes) = (poison(normal(&[3, 5, 6, 24], 1)), normal(&[3, 4, 48], 2), mask(&[3, 4], 0.7, 3));
    let (weight, bias) = (normal(&[9, 24], 4), normal(&[9], 5));
    let ops: [(&str, Op<'_>); 4] = [
        ("time", &|a| self_attention(&a[0], &valid, 2, Axis::Time)),
        ("agent", &|a| self_attention(&a[0], &valid, 2, Axis::Agent)),
        ("lanes", &|a| cross_attention(&a[0], &valid, &keys, &lanes, 2)),
        ("linear", &|a| linear(&a[0], &weight, &bias, Activation::Relu, Some(&valid), Precision::F32)),
    ];
    for (name, op) in ops {
        let results = run(op, std::slice::from_ref(&x), DType::F32);
        for result in results {
            let n = result.len() / 90;
            for (row, valid) in values(&valid).iter().enumerate() {
                let row = &result[row * n..(row + 1) * n];
                assert!(row.iter().all(|v| if *valid == 0.0 { *v == 0.0 } else { v.is_finite() }), "{name}: {row:?}");
            }
        }
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let valid = mask(&[4, 9, 30], 0.7, 1);
    let x = normal(&[4, 9, 30, 48], 2);
    let (weight, bias) = (normal(&[130, 48], 3), normal(&[130], 4));
    let (keys, lanes) = (normal(&[2, 20, 96], 5), mask(&[2, 20], 0.8, 6));
    let all = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let norm = [x.clone(), normal(&[48], 7), normal(&[48], 8)];
            [
                run(
                    &|a| linear(&a[0], &a[1], &a[2], Activation::Relu, Some(&valid), Precision::F32),
                    &[x.clone(), weight.clone(), bias.clone()],
                    DType::F32,
                ),
                run(&|a| layer_norm(&a[0], &a[1], &a[2], 1e-5), &norm, DType::F32),
                run(&|a| self_attention(&a[0], &valid, 2, Axis::Time), std::slice::from_ref(&x), DType::F32),
                run(&|a| self_attention(&a[0], &valid, 2, Axis::Agent), std::slice::from_ref(&x), DType::F32),
                run(&|a| cross_attention(&a[0], &valid, &a[1], &lanes, 2), &[x.clone(), keys.clone()], DType::F32),
                run(&|a| sinusoidal(&a[0], &[1.0, 3.0]), std::slice::from_ref(&x), DType::F32),
            ]
        })
    };
    let one = all(1);
    assert_eq!(one, all(2));
    assert_eq!(one, all(5));
}

#[test]
fn frozen_arguments_get_no_gradients() {
    let x = Var::from_tensor(&normal(&[5, 4], 1)).unwrap();
    let (weight, bias) = (normal(&[3, 4], 2), normal(&[3], 3));
    let y = linear(x.as_tensor(), &weight, &bias, Activation::Relu, None, Precision::F32).unwrap();
    let grads =
        layer_norm(&y, &normal(&[3], 4), &bias, 1e-5).unwrap().sqr().unwrap().sum_all().unwrap().backward().unwrap();
    assert!(grads.get(x.as_tensor()).is_some());
    assert!(grads.get(&weight).is_none() && grads.get(&bias).is_none());
    assert!(!linear(&normal(&[5, 4], 1), &weight, &bias, Activation::None, None, Precision::F32).unwrap().track_op());
}

#[test]
fn arguments_need_not_be_contiguous() {
    let (weight, bias) = (normal(&[4, 3], 2), normal(&[3], 3));
    check(
        &|a| linear(&a[0].t()?, &a[1].t()?, &a[2], Activation::None, None, Precision::F32),
        &[normal(&[4, 6], 1), weight, bias],
        "linear",
    );
    let valid = mask(&[2, 3, 4], 0.7, 1);
    check(&|a| self_attention(&a[0].transpose(1, 2)?, &valid, 1, Axis::Time), &[normal(&[2, 4, 3, 6], 1)], "attention");
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    let x = normal(&[2, 3, 4, 12], 1);
    let valid = mask(&[2, 3, 4], 1.0, 1);
    assert!(linear(&x, &normal(&[5, 11], 2), &normal(&[5], 3), Activation::None, None, Precision::F32).is_err());
    assert!(
        linear(
            &x,
            &normal(&[5, 12], 2),
            &normal(&[5], 3),
            Activation::None,
            Some(&mask(&[2, 3], 1.0, 1)),
            Precision::F32
        )
        .is_err()
    );
    assert!(layer_norm(&x, &normal(&[11], 2), &normal(&[12], 3), 1e-5).is_err());
    assert!(self_attention(&x, &valid, 5, Axis::Time).is_err());
    assert!(cross_attention(&x, &valid, &normal(&[2, 7, 23], 2), &mask(&[2, 7], 1.0, 1), 2).is_err());
    assert!(cross_attention(&x, &valid, &normal(&[3, 7, 24], 2), &mask(&[3, 7], 1.0, 1), 2).is_err());
}
