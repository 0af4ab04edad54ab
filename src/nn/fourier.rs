//! Sinusoidal encodings of numbers: how does a network see small and large differences of a position, time or noise
//! level?

use candle_core::{Result, Tensor, bail};

use super::ops;

/// `dim` features of every entry of `x` (..): the sines, then the cosines, of 2 π x / p for `dim` / 2 periods p that
/// grow geometrically from `min_period` to `max_period` (Vaswani et al. 2017, with the periods of DJINN's appendix A).
/// Returns (.., `dim`), differentiable in `x`.
///
/// # Errors
/// When `dim` is odd or 0, or the periods are not positive.
pub fn sinusoidal(x: &Tensor, dim: usize, min_period: f64, max_period: f64) -> Result<Tensor> {
    if dim == 0 || !dim.is_multiple_of(2) {
        bail!("a sinusoidal encoding needs an even number of features, not {dim}");
    }
    if !(min_period > 0.0 && max_period >= min_period) {
        bail!("a sinusoidal encoding needs 0 < min_period <= max_period, not {min_period} and {max_period}");
    }
    let n = dim / 2;
    let growth = if n > 1 { (max_period / min_period).ln() / (n - 1) as f64 } else { 0.0 };
    let frequencies: Vec<f64> = (0..n).map(|i| (-(growth * i as f64)).exp() / min_period).collect();
    ops::sinusoidal(x, &frequencies)
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn periods_grow_geometrically_between_the_bounds() {
        // Periods 1, 10 and 100.
        let x = Tensor::new(&[0.25f32, 10.0], &Device::Cpu).unwrap();
        let encoded = sinusoidal(&x, 6, 1.0, 100.0).unwrap().to_vec2::<f32>().unwrap();
        let turn = std::f32::consts::TAU;
        let expected = [
            [1.0, (turn * 0.025).sin(), (turn * 0.0025).sin(), 0.0, (turn * 0.025).cos(), (turn * 0.0025).cos()],
            [0.0, 0.0, (turn * 0.1).sin(), 1.0, 1.0, (turn * 0.1).cos()],
        ];
        for (found, expected) in encoded.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-6, "{encoded:?}");
        }
    }

    #[test]
    fn bad_arguments_are_errors() {
        let x = Tensor::new(&[0f32], &Device::Cpu).unwrap();
        assert!(sinusoidal(&x, 5, 1.0, 2.0).is_err());
        assert!(sinusoidal(&x, 0, 1.0, 2.0).is_err());
        assert!(sinusoidal(&x, 4, 0.0, 2.0).is_err());
        assert!(sinusoidal(&x, 4, 3.0, 2.0).is_err());
        assert_eq!(sinusoidal(&x, 2, 3.0, 3.0).unwrap().dims(), [1, 2]);
    }
}
