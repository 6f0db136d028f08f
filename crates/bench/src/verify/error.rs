//! Why a check against reference tensors cannot run.

use std::path::PathBuf;

use unopose_infer::InferError;

/// Error of a check against reference tensors.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VerifyError {
    /// A file of tensors or tolerances cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The tensors are in another format.
    #[error("{} is not a safetensors file: {message}", path.display())]
    Format {
        /// The file of tensors.
        path: PathBuf,
        /// The reader's message.
        message: String,
    },
    /// A stored tensor is missing or of another type, shape or range than expected.
    #[error("{}: tensor {name} {message}", path.display())]
    Tensor {
        /// The file of tensors.
        path: PathBuf,
        /// The tensor's name in the file.
        name: String,
        /// What was met and expected, as the rest of a sentence about the tensor.
        message: String,
    },
    /// A file of tolerances that is no JSON of bounds.
    #[error("{}: {message}", path.display())]
    Tolerances {
        /// The file of tolerances.
        path: PathBuf,
        /// What was met and expected.
        message: String,
    },
    /// The configuration and the tensors are of different sizes.
    #[error("{field} is {configured} in the configuration, but the tensors have {found} ({tensor})")]
    Size {
        /// Key of the configuration.
        field: &'static str,
        /// Its value in the configuration.
        configured: usize,
        /// Its value by the tensors.
        found: usize,
        /// The tensor that says so.
        tensor: &'static str,
    },
    /// The network lacks a part that the stored tensors come from.
    #[error("these weights have no {0}, which reference tensors of this kind need")]
    Part(&'static str),
    /// The network failed.
    #[error(transparent)]
    Infer(#[from] InferError),
}
