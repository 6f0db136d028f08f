//! Why an analysis fails.

use unopose_core::files::FileError;
use unopose_dataset::formats::FormatError;
use unopose_eval::{metrics::EvalError, report::ReportError};
use unopose_infer::InferError;
use unopose_nn::checkpoint::CheckpointError;

/// Error of an analysis.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AnalysisError {
    /// Right or wrong pairs are too few for a calibration.
    #[error(
        "{right} of {pairs} pairs are right, expected at least 20 right and 20 wrong ones: calibrate on more or more \
         varied pairs"
    )]
    TooFewOutcomes {
        /// Number of all pairs.
        pairs: usize,
        /// Number of those with a right pose.
        right: usize,
    },
    /// The network failed.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// A checkpoint cannot be read or written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The poses cannot be scored.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] FileError),
    /// The dataset cannot be read.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Curves cannot be drawn.
    #[error(transparent)]
    Report(#[from] ReportError),
}
