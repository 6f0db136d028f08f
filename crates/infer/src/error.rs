//! Why there is no pose.

use std::path::PathBuf;

use unopose_dataset::formats::FormatError;
use unopose_nn::{checkpoint::CheckpointError, device::DeviceError};
use unopose_pairs::data::DataError;

/// Why a view, a pair or a reference file gives no pose.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // Each message says what is wrong.
pub enum InferError {
    #[error("unusable reference: {0}")]
    Reference(#[source] DataError),
    #[error("unusable query: {0}")]
    Query(#[source] DataError),
    #[error("the network's {what} cannot be read back from the device: {message}")]
    Readback { what: &'static str, message: String },
    #[error("the forward pass failed: {message}")]
    Forward { message: String },
    #[error(
        "{query} query and {reference} reference points, expected equal counts: the release splits the overlaps at the \
         reference's (model.quirks.score_split_at_reference)"
    )]
    UnequalCounts { query: usize, reference: usize },
    #[error(
        "the estimated pose, its score or overlap is not finite: are the checkpoint's weights or the kept reference broken?"
    )]
    NotFinite,
    #[error("the network gave no result for this pair")]
    Incomplete,
    #[error(
        "no checkpoint: looked for {}, and none is embedded in this build; name one with --checkpoint",
        looked.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    NoCheckpoint { looked: Vec<PathBuf> },
    #[error("{}: {field} is {value}, expected {expected}", path.display())]
    ReferenceFile { path: PathBuf, field: String, value: String, expected: String },
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Device(#[from] DeviceError),
    #[error(transparent)]
    Format(#[from] FormatError),
}

impl InferError {
    /// For `map_err`: `what` cannot be read from the device.
    pub fn readback<E: std::fmt::Display>(what: &'static str) -> impl Fn(E) -> Self {
        move |error: E| Self::Readback { what, message: error.to_string() }
    }
}
