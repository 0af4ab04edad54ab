//! Runs a network on a thread of the pool that does its work.

use candle_core::Device;

/// Runs `work` on a thread of rayon's pool. From any other thread, each of a network's many operations would be passed
/// to the pool and waited for.
pub fn in_pool<R: Send>(device: &Device, work: impl FnOnce() -> R + Send) -> R {
    match device {
        Device::Cpu => rayon::scope(|_| work()),
        _ => work(),
    }
}
