//! Why a benchmark stops.

use crate::{eval::EvalError, formats::FormatError, report::ReportError};

/// Error of the `bench` room.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Eval(#[from] EvalError),
    #[error(transparent)]
    Report(#[from] ReportError),
}
