//! Why a check against reference tensors cannot run.

use std::path::PathBuf;

use unopose_infer::InferError;

/// Error of the `verify` room.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{} is not a safetensors file: {message}", path.display())]
    Format { path: PathBuf, message: String },
    #[error("{}: tensor {name} {message}", path.display())]
    Tensor { path: PathBuf, name: String, message: String },
    #[error("{}: {message}", path.display())]
    Tolerances { path: PathBuf, message: String },
    #[error("{field} is {configured} in the configuration, but the tensors have {found} ({tensor})")]
    Size { field: &'static str, configured: usize, found: usize, tensor: &'static str },
    #[error("these weights have no {0}, which reference tensors of this kind need")]
    Part(&'static str),
    #[error(transparent)]
    Infer(#[from] InferError),
}
