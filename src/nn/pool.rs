//! Who calls a network: a thread that hands it each operation, or one of those that do the work?

use candle_core::Device;

/// Runs `work` on a thread of the pool where the pool computes. From any other thread each of a network's many operations would be
/// handed to the pool and waited for.
pub fn in_pool<R: Send>(device: &Device, work: impl FnOnce() -> R + Send) -> R {
    match device {
        Device::Cpu => rayon::scope(|_| work()),
        _ => work(),
    }
}
