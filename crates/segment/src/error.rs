//! Why an image or a reference cannot be segmented.

use unopose_dataset::{formats::FormatError, mesh::MeshError};
use unopose_infer::InferError;
use unopose_nn::{checkpoint::CheckpointError, device::DeviceError};

/// Why an image or a reference cannot be segmented.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentError {
    /// The views of an object cannot describe it.
    #[error("unusable reference mask: {reason}")]
    Reference {
        /// What is wrong with its mask.
        reason: String,
    },
    /// A point, a box or another input value cannot be used.
    #[error("{what} is {value}, expected {expected}")]
    Prompt {
        /// `point`, `box` or another name of the input.
        what: &'static str,
        /// The value met.
        value: String,
        /// The values accepted.
        expected: String,
    },
    /// An image does not show the object.
    #[error("not found: {proposals} proposals in {image}{}", like_the_reference(*proposals, *best))]
    NotFound {
        /// Path of the image.
        image: String,
        /// Candidate masks found in it.
        proposals: usize,
        /// Score of the best of them, and the least score of an instance.
        best: Option<(f64, f64)>,
    },
    /// An object was described by another kind of matcher.
    #[error("an object described by another matcher cannot be compared by {matcher}")]
    OtherMatcher {
        /// Name of the matcher that was to compare it.
        matcher: String,
    },
    /// Weights cannot be read or do not fit their network.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// There are no weights of the proposal network in the program.
    #[error(
        "the program was built without checkpoints/proposals.safetensors, expected weights: --proposals learned:FILE or both:FILE"
    )]
    NoProposalWeights,
    /// An image cannot be given to the proposal network.
    #[error("learned proposals: {0}")]
    Scene(#[from] unopose_pairs::data::DataError),
    /// The device cannot be opened.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A CAD model cannot be read.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A file of a data set or a list of masks is malformed.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A view cannot be prepared, or a result cannot be read from the device.
    #[error(transparent)]
    Infer(#[from] InferError),
}

/// How near the proposals of an image come to the reference, for a message.
fn like_the_reference(proposals: usize, best: Option<(f64, f64)>) -> String {
    match best {
        Some((score, least)) => {
            format!(
                ", none is like the reference (the best one scores {score:.2}, an instance at least {least:.2})"
            )
        }
        None if proposals > 0 => ", none is like the reference".into(),
        None => String::new(),
    }
}
