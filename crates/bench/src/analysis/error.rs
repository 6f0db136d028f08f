//! Why an analysis ended.

use unopose_core::files::FileError;
use unopose_dataset::formats::FormatError;
use unopose_eval::{eval::EvalError, report::ReportError};
use unopose_infer::InferError;
use unopose_nn::checkpoint::CheckpointError;

/// Error of the `analysis` room.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    #[error(
        "{right} of {pairs} pairs are right, expected at least 20 right and 20 wrong ones: calibrate on more or more \
         varied pairs"
    )]
    TooFewOutcomes { pairs: usize, right: usize },
    #[error(transparent)]
    Infer(#[from] InferError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Eval(#[from] EvalError),
    #[error(transparent)]
    Write(#[from] FileError),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Report(#[from] ReportError),
}
