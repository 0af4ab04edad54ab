//! The device and precision of networks.

use candle_core::Device;

use super::precision::Precision;

/// A device, and the precision of products on it. Parameters carry it to the layers that are built on them.
#[derive(Debug, Clone)]
pub struct Compute {
    /// The device that holds parameters and batches.
    pub device: Device,
    /// The precision of the matrix products of linear maps.
    pub precision: Precision,
}

impl Compute {
    /// The processor, in single precision.
    pub const fn cpu() -> Self {
        Self { device: Device::Cpu, precision: Precision::F32 }
    }
}
