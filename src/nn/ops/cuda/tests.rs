//! The kernels against the plain operations in double precision: on the emulator, and on a GPU where there is one.

use candle_core::{DType, Device, Result, Tensor, Var};
use gemmkit::bf16;

use super::super::tests::{NEIGHBOR, Op, assert_close, check, mask, normal, padded_states, run};
use super::super::{self as ops, Activation, AdamStep, Moments};
use super::launch::{self, Argument, Launch};
use super::*;
use crate::nn::attention::Axis;
use crate::nn::precision::Precision;
use crate::nn::testing::values;

/// Where kernels can run here.
fn devices() -> Vec<Device> {
    let gpu = candle_core::utils::cuda_is_available().then(|| Device::new_cuda_with_stream(0).ok()).flatten();
    [Device::Cpu].into_iter().chain(gpu).collect()
}

/// Checks values and gradients of `kernel`, which takes `f32` on any device, against `plain` in `f64`.
fn check_kernel(kernel: Op<'_>, plain: Op<'_>, arguments: &[Tensor], what: &str) {
    for device in devices() {
        let op = |a: &[Tensor]| -> Result<Tensor> {
            if a[0].dtype() == DType::F64 {
                return plain(a);
            }
            let there: Vec<Tensor> = a.iter().map(|a| a.to_device(&device)).collect::<Result<_>>()?;
            kernel(&there)?.to_device(&Device::Cpu)
        };
        check(&op, arguments, &format!("{what} on {:?}", device.location()));
    }
}

/// A mask where `x` is.
fn at(x: &Tensor, mask: &Tensor) -> Tensor {
    mask.to_device(x.device()).unwrap()
}

#[test]
fn linear_agrees() {
    for activation in [Activation::None, Activation::Relu] {
        // More rows than a block sums; more columns than a warp; rows that are no multiple of anything.
        for (rows, n_in, n_out) in [(vec![2, 3, 50], 20, 70), (vec![1], 7, 3), (vec![1030], 2, 33)] {
            let shape: Vec<usize> = rows.iter().copied().chain([n_in]).collect();
            let arguments = [normal(&shape, 1), normal(&[n_out, n_in], 2), normal(&[n_out], 3)];
            for valid in [None, Some(mask(&rows, 0.6, 4)), Some(mask(&rows, 0.0, 4))] {
                check_kernel(
                    &|a| {
                        let valid = valid.as_ref().map(|valid| at(&a[0], valid));
                        linear(&a[0], &a[1], &a[2], activation, valid.as_ref(), Precision::F32)
                    },
                    &|a| ops::linear(&a[0], &a[1], &a[2], activation, valid.as_ref(), Precision::F32),
                    &arguments,
                    &format!("{rows:?} {activation:?}"),
                );
            }
        }
    }
}

#[test]
fn layer_norm_agrees() {
    for dims in [&[2, 3, 50, 24][..], &[1, 128], &[7], &[1030, 40]] {
        let dim = dims[dims.len() - 1];
        let arguments = [normal(dims, 1), normal(&[dim], 2), normal(&[dim], 3)];
        check_kernel(
            &|a| layer_norm(&a[0], &a[1], &a[2], 1e-5, Precision::F32),
            &|a| ops::layer_norm(&a[0], &a[1], &a[2], 1e-5, Precision::F32),
            &arguments,
            &format!("{dims:?}"),
        );
    }
}

#[test]
fn self_attention_agrees() {
    for axis in [Axis::Time, Axis::Agent] {
        let few = [normal(&[3, 5, 6, 3 * 16], 1)];
        // More timesteps than a tile holds and a block has threads, and heads of 5 features.
        let many = [normal(&[1, 3, 70, 3 * 10], 2)];
        let cases = [
            (&few, padded_states()),
            (&few, mask(&[3, 5, 6], 1.0, 0)),
            (&few, mask(&[3, 5, 6], 0.0, 0)),
            (&many, mask(&[1, 3, 70], 0.7, 3)),
        ];
        for (arguments, valid) in cases {
            check_kernel(
                &|a| self_attention(&a[0], &at(&a[0], &valid), 2, axis),
                &|a| ops::self_attention(&a[0], &valid, 2, axis),
                arguments,
                &format!("{axis:?} {:?}", valid.dims()),
            );
        }
    }
}

#[test]
fn cross_attention_agrees() {
    let valid = padded_states().repeat((2, 1, 1)).unwrap();
    for (n_maps, n_lanes) in [(6, 7), (2, 7), (1, 40)] {
        for share in [0.6, 0.0] {
            let lanes = mask(&[n_maps, n_lanes], share, 6);
            let arguments = [normal(&[6, 5, 6, 16], 1), normal(&[n_maps, n_lanes, 32], 2)];
            check_kernel(
                &|a| cross_attention(&a[0], &at(&a[0], &valid), &a[1], &at(&a[0], &lanes), 2),
                &|a| ops::cross_attention(&a[0], &valid, &a[1], &lanes, 2),
                &arguments,
                &format!("{n_maps} maps {share}"),
            );
        }
    }
}

#[test]
fn large_scores_do_not_overflow() {
    // Scores of some hundreds, whose exponentials no float holds.
    let valid = mask(&[1, 2, 9], 0.8, 2);
    let qkv = Var::from_tensor(&(normal(&[1, 2, 9, 3 * 8], 1) * 30.0).unwrap()).unwrap();
    let mixed = self_attention(qkv.as_tensor(), &valid, 1, Axis::Time).unwrap();
    let expected = ops::self_attention(&qkv.to_dtype(DType::F64).unwrap(), &valid, 1, Axis::Time).unwrap();
    for (found, expected) in values(&mixed).iter().zip(values(&expected)) {
        assert!((found - expected).abs() < 0.03, "{found} instead of {expected}");
    }
    let grads = mixed.sum_all().unwrap().backward().unwrap();
    assert!(values(grads.get(qkv.as_tensor()).unwrap()).iter().all(|grad| grad.is_finite()));
}

#[test]
fn sinusoidal_agrees() {
    let frequencies = [100.0, 7.3, 0.1];
    check_kernel(
        &|a| sinusoidal(&a[0], &frequencies),
        &|a| ops::sinusoidal(&a[0], &frequencies),
        &[normal(&[3, 50], 1)],
        "sinusoidal",
    );
}

#[test]
fn poisoned_padding_is_never_read_by_attention() {
    let valid = padded_states();
    let keep = valid.unsqueeze(3).unwrap().broadcast_as((3, 5, 6, 24)).unwrap().ne(0.0).unwrap();
    let nan = Tensor::full(f32::NAN, (3, 5, 6, 24), &Device::Cpu).unwrap();
    let qkv = Var::from_tensor(&keep.where_cond(&normal(&[3, 5, 6, 24], 1), &nan).unwrap()).unwrap();
    for axis in [Axis::Time, Axis::Agent] {
        let mixed = self_attention(qkv.as_tensor(), &valid, 2, axis).unwrap();
        let grads = mixed.sum_all().unwrap().backward().unwrap();
        let dqkv = grads.get(qkv.as_tensor()).unwrap();
        assert!(values(&mixed).iter().chain(&values(dqkv)).all(|value| value.is_finite()), "{axis:?}");
    }
}

#[test]
fn the_optimizer_agrees() {
    for device in devices() {
        let put = |x: Tensor| x.to_device(&device).unwrap();
        // More entries than a block sums squares of.
        let (parameter, grad) = (normal(&[300, 70], 1), normal(&[300, 70], 2));
        let moments = || Moments { first: normal(&[300, 70], 3), second: normal(&[300, 70], 4).sqr().unwrap() };
        let step = AdamStep {
            grad_scale: 0.5,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-8,
            step_size: 0.01,
            second_correction: 1.5,
        };
        let moved = put(parameter.copy().unwrap());
        let on_device = Moments { first: put(moments().first), second: put(moments().second) };
        adam_step(&moved, &on_device, &put(grad.clone()), step).unwrap();
        let mut expected = moments();
        ops::adam_step(&parameter, &mut expected, &grad, step).unwrap();
        let assert_close = |a: &Tensor, b: &Tensor| {
            for (a, b) in values(&a.to_device(&Device::Cpu).unwrap()).iter().zip(values(b)) {
                assert!((a - b).abs() < 2e-6 * b.abs().max(1.0), "{a} instead of {b}");
            }
        };
        assert_close(&moved, &parameter);
        assert_close(&on_device.first, &expected.first);
        assert_close(&on_device.second, &expected.second);

        let sum = values(&sums_of_squares(&put(grad.clone())).unwrap().to_device(&Device::Cpu).unwrap());
        let expected: f64 = values(&grad).iter().map(|g| g * g).sum();
        assert_eq!(sum.len(), 2);
        assert!((sum.iter().sum::<f64>() / expected - 1.0).abs() < 1e-6);

        let average = put(parameter.copy().unwrap());
        average_step(&average, &put(grad.clone()), 0.9).unwrap();
        assert_close(&average, &((&parameter * 0.9).unwrap() + (&grad * 0.1).unwrap()).unwrap());
    }
}

#[test]
fn halved_precision_stays_near() {
    let (x, weight, bias) = (normal(&[40, 64], 1), normal(&[32, 64], 2), normal(&[32], 3));
    let map = |precision: Precision| values(&linear(&x, &weight, &bias, Activation::None, None, precision).unwrap());
    let (exact, rounded) = (map(Precision::F32), map(Precision::Bf16));
    // Sums of 64 products of size 1 are of size 8; each factor is off by up to 2⁻⁹, mostly in different directions.
    let errors: Vec<f64> = exact.iter().zip(&rounded).map(|(a, b)| (a - b).abs()).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean > 1e-3 && mean < 0.04, "{mean}");
}

#[test]
fn numbers_are_halved_as_their_type_does_it() {
    let special = [0.0, -0.0, f32::MAX, f32::MIN_POSITIVE, f32::INFINITY, f32::NEG_INFINITY, 1e-40, 3.402e38, f32::NAN];
    let between = (0..1000u32).map(|i| f32::from_bits(0x3f80_7ffe + i % 4 + ((i / 4) << 16)));
    let numbers: Vec<f32> = special.into_iter().chain(between).collect();
    let halves: Vec<bf16> = numbers.iter().map(|number| bf16::from_f32(*number)).collect();
    let n = numbers.len();
    for device in devices() {
        let put = |x: Tensor| x.to_device(&device).unwrap();
        let (whole, zeros) =
            (put(Tensor::from_slice(&numbers, n, &Device::Cpu).unwrap()), normal(&[n], 1).zeros_like());
        let zeros = put(zeros.unwrap());
        // Through the kernel that follows products, whose two flags say what it reads and what it writes.
        let through = |x: &Tensor, halved: bool| {
            let flags = [false, true, launch::is_halved(x), halved].map(Argument::flag);
            let arguments: Vec<_> = [Argument::InEither(x), Argument::In(&zeros), Argument::In(&zeros)]
                .into_iter()
                .chain([Argument::Count(1), Argument::Count(n)])
                .chain(flags)
                .chain([Argument::out(n, halved)])
                .collect();
            let written = Launch::of_numbers("bias_activation", n, &arguments).run_for_one(&device).unwrap();
            launch::tensor(written, n).to_device(&Device::Cpu).unwrap()
        };
        let narrow = through(&whole, true);
        for ((found, expected), number) in narrow.to_vec1::<bf16>().unwrap().iter().zip(&halves).zip(&numbers) {
            // A sum with 0 has no negative 0.
            let same = found == expected || found.is_nan() && expected.is_nan();
            assert!(same, "{number}: {found} instead of {expected}");
        }
        let wide = through(&put(narrow), false);
        for (found, expected) in wide.to_vec1::<f32>().unwrap().iter().zip(&halves) {
            assert!(
                *found == expected.to_f32() || found.is_nan() && expected.is_nan(),
                "{found} instead of {expected}"
            );
        }
    }
}

#[test]
fn what_only_products_read_is_kept_halved() {
    // A block of the network: normalization, a hidden layer, a map. On the processor its factors are rounded when they are multiplied.
    let shape = [2, 3, 25];
    let arguments = [
        normal(&[2, 3, 25, 20], 1),
        normal(&[20], 2),
        normal(&[20], 3),
        normal(&[70, 20], 4),
        normal(&[70], 5),
        normal(&[9, 70], 6),
        normal(&[9], 7),
    ];
    for valid in [None, Some(mask(&shape, 0.6, 8))] {
        let processor = |a: &[Tensor]| {
            let x = ops::layer_norm(&a[0], &a[1], &a[2], 1e-5, Precision::Bf16)?;
            let x = ops::linear(&x, &a[3], &a[4], Activation::Relu, valid.as_ref(), Precision::Bf16)?;
            ops::linear(&x, &a[5], &a[6], Activation::None, valid.as_ref(), Precision::Bf16)
        };
        let expected = run(&processor, &arguments, DType::F32);
        for device in devices() {
            let kernels = |a: &[Tensor]| -> Result<Tensor> {
                let a: Vec<Tensor> = a.iter().map(|a| a.to_device(&device)).collect::<Result<_>>()?;
                let valid = valid.as_ref().map(|valid| at(&a[0], valid));
                let x = layer_norm(&a[0], &a[1], &a[2], 1e-5, Precision::Bf16)?;
                let hidden = linear(&x, &a[3], &a[4], Activation::Relu, valid.as_ref(), Precision::Bf16)?;
                let y = linear(&hidden, &a[5], &a[6], Activation::None, valid.as_ref(), Precision::Bf16)?;
                assert_eq!([x.dtype(), hidden.dtype(), y.dtype()], [DType::BF16, DType::BF16, DType::F32]);
                y.to_device(&Device::Cpu)
            };
            for (i, (found, expected)) in run(&kernels, &arguments, DType::F32).iter().zip(&expected).enumerate() {
                assert_close(found, expected, 2.0 * NEIGHBOR, &format!("{i} on {:?}", device.location()));
            }
        }
    }
}

#[test]
fn attention_takes_whole_numbers_alone() {
    let valid = mask(&[1, 2, 3], 1.0, 0);
    let qkv = normal(&[1, 2, 3, 12], 1).to_dtype(DType::BF16).unwrap();
    assert!(self_attention(&qkv, &valid, 1, Axis::Time).unwrap_err().to_string().contains("f32"));
}

#[test]
fn nothing_to_do_is_no_launch_error() {
    let empty = Tensor::zeros((0, 5), DType::F32, &Device::Cpu).unwrap();
    let (weight, bias) = (normal(&[3, 5], 1), normal(&[3], 2));
    let y = linear(&empty, &weight, &bias, Activation::Relu, None, Precision::F32).unwrap();
    assert_eq!(y.dims(), [0, 3]);
    let shape = Tensor::zeros((0, 2, 3, 12), DType::F32, &Device::Cpu).unwrap();
    let valid = Tensor::zeros((0, 2, 3), DType::F32, &Device::Cpu).unwrap();
    assert_eq!(self_attention(&shape, &valid, 2, Axis::Agent).unwrap().dims(), [0, 2, 3, 4]);
}
