//! Choice of the compute device at run time.
//!
//! The default build holds one backend, `flex` (CPU). The others are cargo features of the same names.

use std::{fmt, str::FromStr};

use burn::tensor::{Device, FloatDType};
use unopose_core::config::Precision;

/// A backend by name, as given to `--device`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The fastest backend of this build that finds hardware: cuda, wgpu (not on a software driver), flex, ndarray.
    #[default]
    Auto,
    /// The CPU, vectorised and multi-threaded.
    Flex,
    /// The CPU by burn's older backend.
    NdArray,
    /// A GPU by Vulkan, Metal or WebGPU.
    Wgpu,
    /// An NVIDIA GPU.
    Cuda,
}

/// Why there is no such device.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
#[allow(missing_docs)] // Each message says what is wrong.
pub enum DeviceError {
    #[error("unknown device {0:?}, expected auto, flex, ndarray, wgpu or cuda")]
    Unknown(String),
    #[error("this build has no {0} backend; build it with `cargo build --release --features {0}`")]
    NotBuilt(DeviceChoice),
    #[error("the {0} backend finds no device on this machine")]
    NoHardware(DeviceChoice),
    #[error("this build has no backend at all; build it with one of the features flex, ndarray, wgpu, cuda")]
    NoBackend,
    #[error(
        "the cuda backend compiles its kernels with {0}, which is missing; install the CUDA toolkit, or its packages NVRTC and \
         CUDART with headers, and set CUDA_PATH to its folder"
    )]
    NoKernelCompiler(&'static str),
    #[error("this device does not compute in {0}; expected f32, or a GPU with {0} (--device)")]
    NoPrecision(Precision),
}

impl FromStr for DeviceChoice {
    type Err = DeviceError;

    fn from_str(name: &str) -> Result<Self, DeviceError> {
        match name {
            "auto" => Ok(Self::Auto),
            "flex" => Ok(Self::Flex),
            "ndarray" => Ok(Self::NdArray),
            "wgpu" => Ok(Self::Wgpu),
            "cuda" => Ok(Self::Cuda),
            _ => Err(DeviceError::Unknown(name.to_owned())),
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Flex => "flex",
            Self::NdArray => "ndarray",
            Self::Wgpu => "wgpu",
            Self::Cuda => "cuda",
        })
    }
}

impl DeviceChoice {
    /// The device, without autodiff, and the name of its backend.
    pub fn open(self) -> Result<(Device, DeviceChoice), DeviceError> {
        match self {
            Self::Auto => [Self::Cuda, Self::Wgpu, Self::Flex, Self::NdArray]
                .into_iter()
                .filter_map(|choice| choice.open().inspect_err(tell_of_unused_gpu).ok())
                .find(|(device, _)| !is_software(device))
                .ok_or(DeviceError::NoBackend),
            Self::Flex => flex(),
            Self::NdArray => ndarray(),
            Self::Wgpu => wgpu(),
            Self::Cuda => cuda(),
        }
    }
}

/// A GPU that is passed over for what is missing beside it is worth a word.
fn tell_of_unused_gpu(error: &DeviceError) {
    if let DeviceError::NoKernelCompiler(_) = error {
        tracing::warn!("{error}");
    }
}

/// Whether tensors of this device live in host memory, so that a kernel on slices costs no transfer.
pub fn is_host(device: &Device) -> bool {
    let plain = device.clone().inner();
    [flex(), ndarray()].into_iter().flatten().any(|(host, _)| host == plain)
}

/// An error on a device that does not compute in this number type, or gains nothing from it: the CPU backends convert
/// every bf16 operand back, and their kernels on slices take single precision only.
pub fn require_precision(device: &Device, precision: Precision) -> Result<(), DeviceError> {
    let computes = match precision {
        Precision::F32 => true,
        Precision::Bf16 => !is_host(device) && device.clone().inner().supports_dtype(FloatDType::BF16),
    };
    if computes { Ok(()) } else { Err(DeviceError::NoPrecision(precision)) }
}

/// Whether this is a graphics driver that computes on the processor, where the CPU backends are many times faster.
fn is_software(device: &Device) -> bool {
    #[cfg(feature = "wgpu")]
    return *device == Device::wgpu(burn::tensor::DeviceKind::Cpu);
    #[cfg(not(feature = "wgpu"))]
    {
        let _ = device;
        false
    }
}

/// Lets glibc keep freed blocks of any size instead of returning them to the system: a training step allocates and frees
/// gigabytes in blocks of megabytes, and the kernel clears fresh pages for them. `perf record` on training steps, sorted
/// by shared object, gave the kernel 16 % of the samples without and 8 % with this; the step's wall time was not measured
/// on a quiet machine. No effect on other C libraries.
#[allow(unsafe_code)]
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    for (parameter, bytes) in
        [(libc::M_MMAP_THRESHOLD, i32::MAX), (libc::M_TRIM_THRESHOLD, i32::MAX), (libc::M_TOP_PAD, 64 << 20)]
    {
        // SAFETY: mallopt only sets allocator parameters; it is called before other threads start.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

type Opened = Result<(Device, DeviceChoice), DeviceError>;

#[cfg(feature = "flex")]
fn flex() -> Opened {
    Ok((Device::flex(), DeviceChoice::Flex))
}

#[cfg(not(feature = "flex"))]
fn flex() -> Opened {
    Err(DeviceError::NotBuilt(DeviceChoice::Flex))
}

#[cfg(feature = "ndarray")]
#[allow(deprecated)] // kept for comparison with flex
fn ndarray() -> Opened {
    Ok((Device::ndarray(), DeviceChoice::NdArray))
}

#[cfg(not(feature = "ndarray"))]
fn ndarray() -> Opened {
    Err(DeviceError::NotBuilt(DeviceChoice::NdArray))
}

#[cfg(feature = "wgpu")]
fn wgpu() -> Opened {
    first_of(burn::tensor::DeviceType::Wgpu, DeviceChoice::Wgpu)
}

#[cfg(not(feature = "wgpu"))]
fn wgpu() -> Opened {
    Err(DeviceError::NotBuilt(DeviceChoice::Wgpu))
}

#[cfg(feature = "cuda")]
fn cuda() -> Opened {
    let device = first_of(burn::tensor::DeviceType::Cuda, DeviceChoice::Cuda)?;
    let headers = cubecl::cuda::install::cuda_path().map(|path| path.join("include/cuda_fp16.h"));
    if !headers.is_some_and(|header| header.is_file()) {
        return Err(DeviceError::NoKernelCompiler("the toolkit's headers (include/cuda_fp16.h)"));
    }
    // Loading the library panics where there is none.
    match std::panic::catch_unwind(|| cudarc::nvrtc::compile_ptx("")) {
        Ok(Ok(_)) => Ok(device),
        _ => Err(DeviceError::NoKernelCompiler("NVRTC (libnvrtc)")),
    }
}

#[cfg(not(feature = "cuda"))]
fn cuda() -> Opened {
    Err(DeviceError::NotBuilt(DeviceChoice::Cuda))
}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
fn first_of(kind: burn::tensor::DeviceType, choice: DeviceChoice) -> Opened {
    let devices = std::panic::catch_unwind(|| Device::enumerate(kind)).ok();
    let device = devices.and_then(|devices| devices.into_iter().next());
    device.map(|device| (device, choice)).ok_or(DeviceError::NoHardware(choice))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_unknown_ones_are_refused() {
        for name in ["auto", "flex", "ndarray", "wgpu", "cuda"] {
            assert_eq!(name.parse::<DeviceChoice>().unwrap().to_string(), name);
        }
        let error = "gpu".parse::<DeviceChoice>().unwrap_err();
        assert_eq!(error.to_string(), "unknown device \"gpu\", expected auto, flex, ndarray, wgpu or cuda");
    }

    #[test]
    #[cfg(feature = "flex")]
    fn the_cpu_computes_in_single_precision_only() {
        let device = Device::flex();
        require_precision(&device, Precision::F32).unwrap();
        for device in [device.clone(), device.autodiff()] {
            let error = require_precision(&device, Precision::Bf16).unwrap_err().to_string();
            assert!(error.contains("does not compute in bf16; expected f32"), "{error}");
        }
    }

    #[test]
    #[cfg(not(feature = "cuda"))]
    fn a_backend_that_is_not_built_names_its_feature() {
        let error = DeviceChoice::Cuda.open().unwrap_err();
        assert!(error.to_string().contains("--features cuda"), "{error}");
        assert!(DeviceChoice::Auto.open().is_ok());
    }
}
