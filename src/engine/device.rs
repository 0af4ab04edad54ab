//! The device and the precision of networks.

use super::failure::{Failure, Result};
use crate::nn::{Compute, Precision};
use crate::settings::{self, Issue, Unreadable};
use candle_core::Device;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// What networks compute on: `cpu`, `cuda` (the first GPU) or `cuda:1` (the second one), and so on.
///
/// A change of device does not make a finished stage run again. An interrupted training continues on the device that is
/// chosen now; interrupted shards of another kind of device are not used.
/// Results are the same bytes on the same kind of device only, because kinds of device sum in different orders. Noise
/// is always drawn on the host, so that samples of one seed are alike on all devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub enum DeviceChoice {
    /// The processor.
    #[default]
    Cpu,
    /// The NVIDIA GPU of this number; needs a program built with `--features cuda`.
    Cuda(usize),
}

impl DeviceChoice {
    /// The device, ready to compute.
    ///
    /// # Errors
    /// When the program was built without CUDA, or there is no such GPU.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda(ordinal) if candle_core::utils::cuda_is_available() => {
                // One stream for all threads: candle's default is one per thread, which nothing would keep in order.
                Device::new_cuda_with_stream(ordinal).map_err(|error| {
                    // The message also has a backtrace after its first line.
                    let text = error.to_string();
                    let error = text.lines().next().unwrap_or_default();
                    Failure::input_message(format_args!("run.device is \"{self}\", which does not answer: {error}"))
                        .with_hint("nvidia-smi lists the GPUs of this machine; run.device = \"cpu\" needs none")
                })
            }
            Self::Cuda(_) => Err(Failure::input_message(format_args!(
                "run.device is \"{self}\", but this program was built without CUDA"
            ))
            .with_hint("build it with `cargo build --release --features cuda`, or set run.device = \"cpu\"")),
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(0) => f.write_str("cuda"),
            Self::Cuda(ordinal) => write!(f, "cuda:{ordinal}"),
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = Unreadable;

    fn from_str(text: &str) -> std::result::Result<Self, Unreadable> {
        let gpu = match text {
            "cpu" => return Ok(Self::Cpu),
            "cuda" => Some(0),
            other => other.strip_prefix("cuda:").and_then(|ordinal| ordinal.parse().ok()),
        };
        let unknown = || Unreadable(format!("unknown device `{text}`; known here: cpu, cuda, cuda:N"));
        gpu.map(Self::Cuda).ok_or_else(unknown)
    }
}

impl TryFrom<String> for DeviceChoice {
    type Error = Unreadable;

    fn try_from(text: String) -> std::result::Result<Self, Unreadable> {
        text.parse()
    }
}

impl From<DeviceChoice> for String {
    fn from(device: DeviceChoice) -> Self {
        device.to_string()
    }
}

/// The configured device and precision of networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ComputeChoice {
    /// The device that networks compute on.
    pub device: DeviceChoice,
    /// The precision of products.
    pub precision: Precision,
}

impl ComputeChoice {
    /// The device, ready to compute.
    ///
    /// # Errors
    /// As [`DeviceChoice::open`], and when the device has no products of this precision.
    pub fn open(self) -> Result<Compute> {
        self.check().map_err(|issue| Failure::input(issue.within("run")))?;
        Ok(Compute { device: self.device.open()?, precision: self.precision })
    }
}

impl ComputeChoice {
    /// Refuses precisions that only tensor cores of GPUs have.
    pub fn check(self) -> settings::Result {
        match (self.device, self.precision) {
            (DeviceChoice::Cpu, Precision::Tf32 | Precision::Bf16) => Err(Issue::new(
                "precision",
                format_args!(
                    "is \"{}\", which needs the tensor cores of a GPU: set run.device = \"cuda\", or \
                     run.precision = \"f32\"",
                    self.precision
                ),
            )),
            _ => Ok(()),
        }
    }

    /// The class of machine, which decides the last digits of results: the kind of device and the precision of
    /// products. The kind of a processor is its widest vector instructions, the kind of a GPU its model as listed by
    /// the driver.
    pub fn class(self) -> String {
        let kind = match self.device {
            DeviceChoice::Cpu => processor_class(),
            DeviceChoice::Cuda(_) => gpu_class(Path::new("/proc/driver/nvidia/gpus")),
        };
        format!("{kind}, {}", self.precision)
    }
}

#[cfg(target_arch = "x86_64")]
fn processor_class() -> String {
    use std::arch::is_x86_feature_detected;
    let vectors = match () {
        () if is_x86_feature_detected!("avx512f") => "-v4",
        () if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") => "-v3",
        () => "",
    };
    format!("cpu x86-64{vectors}")
}

#[cfg(not(target_arch = "x86_64"))]
fn processor_class() -> String {
    format!("cpu {}", std::env::consts::ARCH)
}

/// The models of the GPUs with a folder in `list`; NVIDIA's driver makes one folder for each.
fn gpu_class(list: &Path) -> String {
    let mut models = BTreeSet::new();
    for gpu in std::fs::read_dir(list).into_iter().flatten().flatten() {
        let text = fs_err::read_to_string(gpu.path().join("information")).unwrap_or_default();
        let model = text.lines().find_map(|line| line.strip_prefix("Model:"));
        models.extend(model.map(|model| model.trim().to_owned()));
    }
    let models = Vec::from_iter(models);
    format!("cuda {}", if models.is_empty() { "of unknown model".to_owned() } else { models.join(" and ") })
}

impl fmt::Display for ComputeChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.precision {
            Precision::F32 => self.device.fmt(f),
            precision => write!(f, "{}, {precision}", self.device),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_say_when_products_are_rounded() {
        let compute = ComputeChoice { device: DeviceChoice::Cuda(0), precision: Precision::Bf16 };
        let found = (compute.to_string(), ComputeChoice::default().to_string());
        assert_eq!(found, ("cuda, bf16".into(), "cpu".into()));
    }

    #[test]
    fn gpus_are_told_apart_by_their_model() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(gpu_class(&folder.path().join("missing")), "cuda of unknown model");
        for (gpu, model) in [("0000:01:00.0", "NVIDIA H200"), ("0000:02:00.0", "NVIDIA H200")] {
            fs_err::create_dir(folder.path().join(gpu)).unwrap();
            let text = format!("Model: \t\t {model}\nIRQ:   \t\t 16\n");
            fs_err::write(folder.path().join(gpu).join("information"), text).unwrap();
        }
        assert_eq!(gpu_class(folder.path()), "cuda NVIDIA H200");
        assert!(ComputeChoice::default().class().starts_with("cpu "));
    }

    #[test]
    fn names_are_read_and_written_alike() {
        for (text, device) in
            [("cpu", DeviceChoice::Cpu), ("cuda", DeviceChoice::Cuda(0)), ("cuda:3", DeviceChoice::Cuda(3))]
        {
            assert_eq!((text.parse(), device.to_string().as_str()), (Ok(device), text));
        }
        for text in ["gpu", "cuda:", "cuda:-1", "CPU"] {
            assert!(text.parse::<DeviceChoice>().unwrap_err().0.contains(text));
        }
    }

    #[test]
    #[cfg(not(feature = "cuda"))]
    fn a_gpu_needs_a_program_that_knows_one() {
        let failure = DeviceChoice::Cuda(1).open().unwrap_err();
        assert!(format!("{:#}", failure.error).contains("\"cuda:1\", but this program was built without CUDA"));
        assert!(DeviceChoice::Cpu.open().unwrap().is_cpu());
    }
}
