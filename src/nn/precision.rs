//! The precision of products inside linear maps.

use std::fmt;
use std::str::FromStr;

use crate::settings::Unreadable;
use candle_core::{DType, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The precision of the matrix products of linear maps. Parameters, sums, the optimizer and everything that other
/// operations read are `f32`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// 24 bits.
    #[default]
    F32,
    /// Factors truncated to 11 bits, sums in `f32`: tensor cores of GPUs since Ampere.
    Tf32,
    /// Factors and results rounded to 8 bits, sums in `f32`: tensor cores of GPUs.
    Bf16,
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::F32 => "f32",
            Self::Tf32 => "tf32",
            Self::Bf16 => "bf16",
        })
    }
}

impl FromStr for Precision {
    type Err = Unreadable;

    fn from_str(text: &str) -> std::result::Result<Self, Unreadable> {
        let known = [Self::F32, Self::Tf32, Self::Bf16].into_iter().find(|precision| precision.to_string() == text);
        known.ok_or_else(|| Unreadable(format!("unknown precision `{text}`; known here: f32, tf32, bf16")))
    }
}

impl Precision {
    /// `x` as a factor of a product: in the type that candle multiplies, and keeps the result in.
    pub(super) fn factor(self, x: &Tensor) -> Result<Tensor> {
        match self {
            // The device truncates for tensor cores.
            Self::F32 | Self::Tf32 => Ok(x.clone()),
            Self::Bf16 => x.to_dtype(DType::BF16),
        }
    }

    /// The product of two factors (N, K) and (K, M), in their type: (N, M).
    pub(super) fn multiply(self, a: &Tensor, b: &Tensor) -> Result<Tensor> {
        #[cfg(feature = "cuda")]
        let _while_multiplying = (self == Self::Tf32).then(TensorCores::take);
        a.matmul(b)
    }

    /// The product of two matrices (N, K) and (K, M), in their type: (N, M).
    pub(super) fn product(self, a: &Tensor, b: &Tensor) -> Result<Tensor> {
        self.multiply(&self.factor(a)?, &self.factor(b)?)?.to_dtype(a.dtype())
    }
}

/// Sends `f32` products to tensor cores while it exists. candle's switch holds for the whole process, but other
/// products, such as those of paths in the motion parametrization, must not lose digits. Only one thread submits work
/// to the GPU.
#[cfg(feature = "cuda")]
struct TensorCores;

#[cfg(feature = "cuda")]
impl TensorCores {
    fn take() -> Self {
        candle_core::cuda_backend::set_gemm_reduced_precision_f32(true);
        Self
    }
}

#[cfg(feature = "cuda")]
impl Drop for TensorCores {
    fn drop(&mut self) {
        candle_core::cuda_backend::set_gemm_reduced_precision_f32(false);
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn names_are_read_and_written_alike() {
        for precision in [Precision::F32, Precision::Tf32, Precision::Bf16] {
            assert_eq!(precision.to_string().parse(), Ok(precision));
        }
        assert!("fp16".parse::<Precision>().unwrap_err().0.contains("fp16"));
    }

    #[test]
    fn bf16_keeps_eight_bits() {
        // 1 + 2⁻⁸ lies between 1 and 1 + 2⁻⁷ and rounds to even; 3 · (1 + 2⁻⁷) = 3.0234375 needs nine bits and is
        // rounded.
        let a = Tensor::new(&[[1.003_906_2f32, 3.0]], &Device::Cpu).unwrap();
        let b = Tensor::new(&[[1f32, 0.0], [0.0, 1.007_812_5]], &Device::Cpu).unwrap();
        let product = |precision: Precision| precision.product(&a, &b).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(product(Precision::F32), [[1.003_906_2, 3.023_437_5]]);
        assert_eq!(product(Precision::Tf32), product(Precision::F32));
        assert_eq!(product(Precision::Bf16), [[1.0, 3.031_25]]);
    }
}
