//! Sums, exponentials and sines over slices, in loops that the compiler can vectorize, with equal results on every
//! machine.

/// Compiles loops for the widest vectors of this processor, although the program itself runs on any. Each number comes
/// from the same operations in the same order, whatever the width.
#[inline(always)]
pub(super) fn vectorized<R>(loops: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(loops)
}

/// Partial sums that a reduction keeps: a multiple of every vector width, and fixed.
const N_LANES: usize = 16;

/// The sum of `term` over `a`.
#[inline(always)]
pub(super) fn sum(a: &[f32], term: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0.0; N_LANES];
    let (blocks, rest) = a.as_chunks::<N_LANES>();
    for block in blocks {
        for i in 0..N_LANES {
            lanes[i] += term(block[i]);
        }
    }
    for (lane, a) in lanes.iter_mut().zip(rest) {
        *lane += term(*a);
    }
    lanes.iter().sum()
}

/// The sum of `term` over the pairs of `a` and `b`, which have one length.
#[inline(always)]
pub(super) fn sum_pairs(a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [0.0; N_LANES];
    let ((a_blocks, a_rest), (b_blocks, b_rest)) = (a.as_chunks::<N_LANES>(), b.as_chunks::<N_LANES>());
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for i in 0..N_LANES {
            lanes[i] += term(a[i], b[i]);
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(a_rest.iter().zip(b_rest)) {
        *lane += term(*a, *b);
    }
    lanes.iter().sum()
}

/// The largest entry of `a`; -∞ if there is none.
#[inline(always)]
fn max(a: &[f32]) -> f32 {
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    let mut lanes = [f32::NEG_INFINITY; N_LANES];
    let (blocks, rest) = a.as_chunks::<N_LANES>();
    for block in blocks {
        for i in 0..N_LANES {
            lanes[i] = larger(block[i], lanes[i]);
        }
    }
    for (lane, a) in lanes.iter_mut().zip(rest) {
        *lane = larger(*a, *lane);
    }
    lanes.into_iter().fold(f32::NEG_INFINITY, larger)
}

/// Added to a number below 2²² in magnitude, its last bits hold the nearest integer.
const ROUND: f32 = 12_582_912.0;
/// As [`ROUND`], for numbers below 2⁵¹ in double precision.
const ROUND_F64: f64 = 6_755_399_441_055_744.0;

/// eˣ for x <= 0, to 2 units in the last place, and exactly 0 below -50: no weight in a softmax then is so small that
/// its products become denormal, which would slow every later operation down by two orders of magnitude.
#[inline(always)]
fn exp_of_non_positive(x: f32) -> f32 {
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let vanishes = x < -50.0;
    let x = if vanishes { -50.0 } else { x };
    // x = n ln 2 + r with |r| <= ln 2 / 2, and the minimax polynomial of the Cephes library for eʳ.
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let p = 1.987_569_1e-4;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 0.5;
    let exp = p * r * r + r + 1.0;
    let power_of_two = f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    if vanishes { 0.0 } else { exp * power_of_two }
}

/// Replaces every row of `scores` (rows of `n_keys`) by its softmax.
pub(super) fn softmax_rows(scores: &mut [f32], n_keys: usize) {
    vectorized(|| {
        for row in scores.chunks_exact_mut(n_keys) {
            let max = max(row);
            row.iter_mut().for_each(|x| *x = exp_of_non_positive(*x - max));
            let scale = 1.0 / sum(row, |x| x);
            row.iter_mut().for_each(|x| *x *= scale);
        }
    });
}

/// Replaces every row of `grad`, the gradient at softmax `weights`, by the gradient at the scores, times `scale`.
pub(super) fn softmax_rows_backward(grad: &mut [f32], weights: &[f32], n_keys: usize, scale: f32) {
    vectorized(|| {
        for (grad, weights) in grad.chunks_exact_mut(n_keys).zip(weights.chunks_exact(n_keys)) {
            let mean = sum_pairs(grad, weights, |g, w| g * w);
            grad.iter_mut().zip(weights).for_each(|(g, w)| *g = (*g - mean) * w * scale);
        }
    });
}

/// (sin 2πx, cos 2πx) to 1e-7 for |x| < 2⁴⁹: the argument is reduced in double precision before it loses digits.
#[inline(always)]
pub(super) fn sin_cos_of_cycles(x: f64) -> (f32, f32) {
    // Quarter turns q and the rest of the angle, in [-π/4, π/4].
    let quarters = 4.0 * x;
    let rounded = quarters + ROUND_F64;
    let q = rounded.to_bits() as u32;
    let r = (quarters - (rounded - ROUND_F64)) as f32 * std::f32::consts::FRAC_PI_2;
    let r2 = r * r;
    // Minimax polynomials of the Cephes library.
    let sin = ((-1.951_529_6e-4 * r2 + 8.332_161e-3) * r2 - 1.666_665_5e-1) * r2 * r + r;
    let cos = ((2.443_315_7e-5 * r2 - 1.388_731_6e-3) * r2 + 4.166_664_6e-2) * r2 * r2 - 0.5 * r2 + 1.0;
    let (s, c) = if q & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let flip = |value: f32, q: u32| f32::from_bits(value.to_bits() ^ ((q & 2) << 30));
    (flip(s, q), flip(c, q.wrapping_add(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_of_any_width_give_the_same_bits() {
        let numbers: Vec<f32> = (0..1003).map(|i| ((i * 7919) % 1009) as f32 * 0.37 - 180.0).collect();
        let loops = |numbers: &[f32]| -> Vec<u32> {
            let exp = numbers.iter().map(|x| exp_of_non_positive(-x.abs()));
            let sin_cos = numbers.iter().flat_map(|x| <[f32; 2]>::from(sin_cos_of_cycles(f64::from(*x))));
            let sums =
                [sum(numbers, |x| x * x), sum_pairs(&numbers[1..], &numbers[..1002], |a, b| a * b + 0.1), max(numbers)];
            exp.chain(sin_cos).chain(sums).map(f32::to_bits).collect()
        };
        assert_eq!(vectorized(|| loops(&numbers)), loops(&numbers));
    }

    #[test]
    fn sums_take_every_entry_once() {
        for n in [0, 1, 15, 16, 17, 40] {
            let a: Vec<f32> = (0..n).map(|i| i as f32).collect();
            assert_eq!(sum(&a, |x| x), (0..n).sum::<usize>() as f32);
            assert_eq!(sum_pairs(&a, &a, |x, y| x * y), (0..n).map(|i| i * i).sum::<usize>() as f32);
            assert_eq!(max(&a), if n == 0 { f32::NEG_INFINITY } else { (n - 1) as f32 });
        }
    }

    #[test]
    fn exponentials_agree_with_the_library_and_never_become_denormal() {
        for i in 0..=50_000 {
            let x = -(i as f32) / 1000.0;
            let expected = f64::from(x).exp();
            let error = (f64::from(exp_of_non_positive(x)) - expected).abs() / expected;
            assert!(error < 2.5e-7, "{x}: {error}");
        }
        assert_eq!([-50.1, -88.0, -1e30, f32::NEG_INFINITY].map(exp_of_non_positive), [0.0; 4]);
        assert!(exp_of_non_positive(f32::NAN).is_nan());
    }

    #[test]
    fn sines_agree_with_the_library_over_many_turns() {
        for i in -40_000..40_000 {
            let x = f64::from(i) * 0.012_345;
            let (sin, cos) = sin_cos_of_cycles(x);
            let (expected_sin, expected_cos) = (x.fract() * std::f64::consts::TAU).sin_cos();
            let error = (f64::from(sin) - expected_sin).abs().max((f64::from(cos) - expected_cos).abs());
            assert!(error < 1.5e-7, "{x}: {error}");
        }
    }

    #[test]
    fn softmax_of_known_scores() {
        let mut rows = [0.0, 2f32.ln(), 5f32.ln(), 1000.0, 0.0, -1000.0];
        softmax_rows(&mut rows, 3);
        for (found, expected) in rows.iter().zip([0.125, 0.25, 0.625, 1.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-7, "{rows:?}");
        }
    }
}
