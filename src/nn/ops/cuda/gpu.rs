//! Kernels on a GPU: compiled by NVRTC for the device at hand, loaded once, launched on its stream.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use candle_core::cuda_backend::cudarc::driver::{CudaSlice, CudaView, DeviceRepr, LaunchConfig, PushKernelArg};
use candle_core::cuda_backend::cudarc::nvrtc::{CompileError, CompileOptions, compile_ptx_with_opts};
use candle_core::cuda_backend::{CudaDevice, WrapErr};
use candle_core::{CudaStorage, Result, Storage, bail};
use gemmkit::bf16;

use super::launch::{Argument, Launch, is_halved};

/// All kernels: one module for each number of features of a head.
const SOURCE: &str = concat!(
    include_str!("common.cu"),
    include_str!("adam.cu"),
    include_str!("attention.cu"),
    include_str!("layer_norm.cu"),
    include_str!("linear.cu"),
    include_str!("sinusoidal.cu"),
);

/// The arguments of a kernel, kept alive until it is launched.
enum Given<'a> {
    Tensor(CudaView<'a, f32>),
    Halved(CudaView<'a, bf16>),
    New(CudaSlice<f32>),
    NewHalved(CudaSlice<bf16>),
    Count(u32),
    Number(f32),
}

/// Runs the kernel on the device's stream, without waiting for it.
pub(super) fn run(launch: &Launch<'_>, device: &CudaDevice) -> Result<Vec<Storage>> {
    let tensors: Vec<_> = (launch.arguments.iter())
        .filter_map(|argument| match argument {
            Argument::In(tensor) | Argument::InEither(tensor) | Argument::InOut(tensor) => {
                Some(tensor.storage_and_layout())
            }
            _ => None,
        })
        .collect();
    let mut of_tensors = tensors.iter();
    let mut given = Vec::with_capacity(launch.arguments.len());
    for argument in launch.arguments {
        given.push(match argument {
            Argument::In(_) | Argument::InEither(_) | Argument::InOut(_) => {
                let Some((Storage::Cuda(storage), layout)) = of_tensors.next().map(|(s, layout)| (&**s, layout)) else {
                    bail!("{}: a tensor is not on the GPU", launch.kernel);
                };
                let Some((start, end)) = layout.contiguous_offsets() else {
                    bail!("{}: a kernel needs contiguous tensors", launch.kernel);
                };
                match argument {
                    Argument::InEither(tensor) if is_halved(tensor) => {
                        Given::Halved(storage.as_cuda_slice::<bf16>()?.slice(start..end))
                    }
                    _ => Given::Tensor(storage.as_cuda_slice::<f32>()?.slice(start..end)),
                }
            }
            Argument::Out(len) => Given::New(new_buffer(device, *len)?),
            Argument::OutHalved(len) => Given::NewHalved(new_buffer(device, *len)?),
            Argument::Count(count) => Given::Count(u32::try_from(*count).map_err(candle_core::Error::wrap)?),
            Argument::Number(number) => Given::Number(*number as f32),
        });
    }
    let (x, y) = launch.blocks;
    if x > 0 && y > 0 {
        let ptx = compiled(device, launch.head_dim)?;
        let function = device.get_or_load_custom_func(launch.kernel, &format!("djinn_{}", launch.head_dim), &ptx)?;
        let mut builder = function.builder();
        for given in &given {
            match given {
                Given::Tensor(view) => builder.arg(view),
                Given::Halved(view) => builder.arg(view),
                Given::New(slice) => builder.arg(slice),
                Given::NewHalved(slice) => builder.arg(slice),
                Given::Count(count) => builder.arg(count),
                Given::Number(number) => builder.arg(number),
            };
        }
        let blocks = |n: usize| u32::try_from(n).map_err(candle_core::Error::wrap);
        let config = LaunchConfig {
            grid_dim: (blocks(x)?, blocks(y)?, 1),
            block_dim: (blocks(launch.threads)?, 1, 1),
            shared_mem_bytes: blocks(launch.n_shared * size_of::<f32>())?,
        };
        #[expect(unsafe_code, reason = "kernels take pointers")]
        // SAFETY: kernels read and write only inside their buffers; the emulator checks this in tests for the same
        // launches, with fences around every buffer. Tensors that are changed in place belong to the optimizer, and
        // everything runs in the order of one stream.
        unsafe { builder.launch(config) }.w()?;
    }
    let new = given.into_iter().filter_map(|given| match given {
        Given::New(slice) => Some(Storage::Cuda(CudaStorage::wrap_cuda_slice(slice, device.clone()))),
        Given::NewHalved(slice) => Some(Storage::Cuda(CudaStorage::wrap_cuda_slice(slice, device.clone()))),
        _ => None,
    });
    Ok(new.collect())
}

fn new_buffer<T: DeviceRepr>(device: &CudaDevice, len: usize) -> Result<CudaSlice<T>> {
    #[expect(unsafe_code, reason = "fresh memory of the device holds anything")]
    // SAFETY: every kernel writes all numbers of its new buffers before anyone reads them; tests find NaN where one does not.
    unsafe {
        device.alloc(len)
    }
}

/// The kernels for this GPU as PTX.
fn compiled(device: &CudaDevice, head_dim: usize) -> Result<Arc<str>> {
    type Compiled = BTreeMap<(i32, i32, usize), Arc<str>>;
    static COMPILED: Mutex<Compiled> = Mutex::new(BTreeMap::new());

    let (major, minor) = device.cuda_stream().context().compute_capability().w()?;
    let Ok(mut compiled) = COMPILED.lock() else { bail!("compiling the kernels failed before") };
    if let Some(ptx) = compiled.get(&(major, minor, head_dim)) {
        return Ok(ptx.clone());
    }
    let ptx = compile(major, minor, head_dim)?;
    compiled.insert((major, minor, head_dim), ptx.clone());
    Ok(ptx)
}

fn compile(major: i32, minor: i32, head_dim: usize) -> Result<Arc<str>> {
    let options = CompileOptions {
        options: vec![format!("--gpu-architecture=compute_{major}{minor}"), format!("-DHEAD_DIM={head_dim}")],
        ..CompileOptions::default()
    };
    match compile_ptx_with_opts(SOURCE, options) {
        Ok(ptx) => Ok(ptx.to_src().into()),
        Err(CompileError::CompileError { log, .. }) => bail!("the kernels do not compile: {}", log.to_string_lossy()),
        Err(error) => bail!("NVRTC does not compile the kernels: {error:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_compile_without_a_gpu() {
        for head_dim in [1, 16, 24, 64] {
            let ptx = compile(9, 0, head_dim).unwrap();
            for kernel in ["attention_backward_keys", "layer_norm_backward", "bias_activation", "sinusoidal", "adam"] {
                assert!(ptx.contains(&format!(".entry {kernel}(")), "{kernel}");
            }
        }
    }
}
