//! Why a benchmark stops.

use unopose_core::files::FileError;
use unopose_dataset::{formats::FormatError, mesh::MeshError, protocol::ProtocolError};
use unopose_eval::{eval::EvalError, report::ReportError};

/// Error of the `bench` room.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    #[error(transparent)]
    Write(#[from] FileError),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Eval(#[from] EvalError),
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("unknown ingredient {name:?}, expected some of {expected}")]
    Ingredient { name: String, expected: String },
    #[error("an ablation compares networks, but none is among the methods")]
    NoNetwork,
}
