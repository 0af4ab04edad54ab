//! Kernels on the host, for tests: `emulator.c`, built with the system's C compiler, runs one launch a process.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

use candle_core::{CpuStorage, Result, Storage, bail};
use gemmkit::bf16;

use super::launch::{Argument, Launch, is_halved};
use crate::nn::ops::host::{change_values, values};

thread_local! {
    static IS_EMULATING: Cell<bool> = const { Cell::new(false) };
}

/// Whether tensors of the host take kernels on this thread.
pub(in crate::nn::ops) fn is_emulating() -> bool {
    IS_EMULATING.get()
}

/// Does something with kernels in the place of fused operations, on this thread.
pub(crate) fn emulate<T>(run: impl FnOnce() -> T) -> T {
    IS_EMULATING.set(true);
    let result = run();
    IS_EMULATING.set(false);
    result
}

const FILES: [(&str, &str); 7] = [
    ("emulator.c", include_str!("emulator.c")),
    ("common.cu", include_str!("common.cu")),
    ("adam.cu", include_str!("adam.cu")),
    ("attention.cu", include_str!("attention.cu")),
    ("layer_norm.cu", include_str!("layer_norm.cu")),
    ("linear.cu", include_str!("linear.cu")),
    ("sinusoidal.cu", include_str!("sinusoidal.cu")),
];

/// A built emulator, in a folder that goes with it.
struct Emulator {
    _folder: tempfile::TempDir,
    program: PathBuf,
}

/// The emulator for heads of so many features.
fn emulator(head_dim: usize) -> Arc<Emulator> {
    static BUILT: Mutex<BTreeMap<usize, Arc<Emulator>>> = Mutex::new(BTreeMap::new());
    let mut built = BUILT.lock().unwrap();
    let build = || {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in FILES {
            fs_err::write(folder.path().join(name), text).unwrap();
        }
        let program = folder.path().join("emulator");
        let mut compiler = Command::new("cc");
        compiler.args(["-std=c11", "-O1", "-ffp-contract=off"]);
        compiler.arg(format!("-DHEAD_DIM={head_dim}")).arg("-o").arg(&program);
        let output = compiler.arg(folder.path().join("emulator.c")).arg("-lm").output();
        let output = output.expect("a C compiler called cc, which Rust itself links with");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Arc::new(Emulator { _folder: folder, program })
    };
    built.entry(head_dim).or_insert_with(build).clone()
}

/// Runs the kernel twice, with threads in both orders, which must agree.
pub(super) fn run(launch: &Launch<'_>) -> Result<Vec<Storage>> {
    let (ascending, descending) = (call(launch, false)?, call(launch, true)?);
    assert_eq!(ascending, descending, "{}: the order of threads shows", launch.kernel);
    let mut new = Vec::new();
    let buffers =
        launch.arguments.iter().filter(|argument| !matches!(argument, Argument::Count(_) | Argument::Number(_)));
    for (argument, buffer) in buffers.zip(ascending) {
        match argument {
            Argument::Out(_) => {
                let numbers = floats(&buffer);
                let all_written = numbers.iter().all(|value| value.to_bits() != UNWRITTEN);
                assert!(all_written, "{}: unwritten numbers", launch.kernel);
                new.push(Storage::Cpu(CpuStorage::F32(numbers)));
            }
            Argument::OutHalved(len) => {
                let mut numbers = halves(&buffer);
                let spare = numbers.split_off(*len);
                let all_written = numbers.iter().all(|value| value.to_bits() != HALF_UNWRITTEN);
                assert!(all_written, "{}: unwritten numbers", launch.kernel);
                assert!(
                    spare.iter().all(|value| value.to_bits() == HALF_UNWRITTEN),
                    "{}: written beyond",
                    launch.kernel
                );
                new.push(Storage::Cpu(CpuStorage::BF16(numbers)));
            }
            Argument::InOut(tensor) => change_values(tensor, |values| {
                values.copy_from_slice(&floats(&buffer));
                Ok(())
            })?,
            _ => {}
        }
    }
    Ok(new)
}

/// NaNs that no calculation makes.
const UNWRITTEN: u32 = 0x7fc0_1234;
const HALF_UNWRITTEN: u16 = 0x7fc1;

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

fn halves(bytes: &[u8]) -> Vec<bf16> {
    bytes.as_chunks().0.iter().map(|bytes| bf16::from_le_bytes(*bytes)).collect()
}

/// The bytes of a buffer before the run: whole floats. An odd number of halves has a spare one behind it.
fn bytes_of(argument: &Argument<'_>) -> Result<Vec<u8>> {
    let padded = |mut halves: Vec<u16>| {
        halves.resize(halves.len().next_multiple_of(2), HALF_UNWRITTEN);
        halves.into_iter().flat_map(u16::to_le_bytes).collect()
    };
    Ok(match argument {
        Argument::InEither(tensor) if is_halved(tensor) => {
            padded(tensor.flatten_all()?.to_vec1::<bf16>()?.into_iter().map(bf16::to_bits).collect())
        }
        Argument::In(tensor) | Argument::InEither(tensor) | Argument::InOut(tensor) => {
            values(tensor)?.iter().flat_map(|value| value.to_le_bytes()).collect()
        }
        Argument::Out(len) => std::iter::repeat_n(UNWRITTEN.to_le_bytes(), *len).flatten().collect(),
        Argument::OutHalved(len) => padded(vec![HALF_UNWRITTEN; *len]),
        Argument::Count(_) | Argument::Number(_) => vec![],
    })
}

/// The bytes of the buffers after one run, in the order of the arguments.
fn call(launch: &Launch<'_>, descending: bool) -> Result<Vec<Vec<u8>>> {
    let mut name = [0; 64];
    name[..launch.kernel.len()].copy_from_slice(launch.kernel.as_bytes());
    let mut request = name.to_vec();
    let put = |request: &mut Vec<u8>, n: usize| request.extend((n as u32).to_le_bytes());
    let Launch { blocks, threads, n_shared, .. } = launch;
    for n in [blocks.0, blocks.1, *threads, *n_shared, usize::from(descending), launch.arguments.len()] {
        put(&mut request, n);
    }
    let mut lengths = Vec::new();
    for argument in launch.arguments {
        match argument {
            Argument::Count(count) => {
                request.push(b'u');
                put(&mut request, *count);
            }
            Argument::Number(number) => {
                request.push(b'f');
                request.extend((*number as f32).to_le_bytes());
            }
            buffer => {
                let bytes = bytes_of(buffer)?;
                request.push(b'b');
                put(&mut request, bytes.len() / size_of::<f32>());
                lengths.push(bytes.len());
                request.extend(bytes);
            }
        }
    }
    let mut child = Command::new(&emulator(launch.head_dim).program)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    // The emulator reads everything before it writes anything; what it refuses early breaks the pipe, and its message says more.
    let sent = child.stdin.take().map(|mut stdin| stdin.write_all(&request));
    let output = child.wait_with_output()?;
    if !output.status.success() {
        bail!("{}: {} {}", launch.kernel, output.status, String::from_utf8_lossy(&output.stderr));
    }
    sent.transpose()?;
    let mut bytes = output.stdout.into_iter();
    Ok(lengths.into_iter().map(|len| bytes.by_ref().take(len).collect()).collect())
}
