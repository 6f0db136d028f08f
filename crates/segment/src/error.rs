//! Why there is no mask.

use unopose_dataset::{formats::FormatError, mesh::MeshError};
use unopose_infer::InferError;
use unopose_nn::{checkpoint::CheckpointError, device::DeviceError};

/// Why an image or a reference cannot be segmented.
#[derive(Debug, thiserror::Error)]
pub enum SegmentError {
    #[error("unusable reference mask: {reason}")]
    Reference { reason: String },
    #[error("{what} is {value}, expected {expected}")]
    Prompt { what: &'static str, value: String, expected: String },
    #[error("not found: {proposals} proposals in {image}{}", if *proposals > 0 { ", none is like the reference" } else { "" })]
    NotFound { image: String, proposals: usize },
    #[error("an object described by another matcher cannot be compared by {matcher}")]
    OtherMatcher { matcher: String },
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Device(#[from] DeviceError),
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Infer(#[from] InferError),
}
