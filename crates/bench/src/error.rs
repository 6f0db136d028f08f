//! Why a benchmark fails.

use unopose_core::files::FileError;
use unopose_dataset::{formats::FormatError, mesh::MeshError, protocol::ProtocolError};
use unopose_eval::{eval::EvalError, report::ReportError};
use unopose_pairs::data::DataError;

/// Error of a benchmark.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] FileError),
    /// Dataset, list, detections or kept results cannot be read.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The poses cannot be scored.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// Curves or overlays cannot be drawn.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A list cannot be built.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// A model cannot be read.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// An ablation names something that is none of [`INGREDIENTS`](super::INGREDIENTS).
    #[error("unknown ingredient {name:?}, expected some of {expected}")]
    Ingredient {
        /// The unknown name.
        name: String,
        /// All known names, separated by commas.
        expected: String,
    },
    /// A view of a pair cannot be prepared.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An ablation without a network.
    #[error("an ablation compares networks, but none is among the methods")]
    NoNetwork,
}
