//! Why lists cannot be made.

use crate::{formats::FormatError, mesh::MeshError};

/// Error of building a list.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProtocolError {
    /// The dataset cannot be read.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A model cannot be read.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// No protocol has this name.
    #[error("unknown list {name:?}, expected one of {}", .expected.join(", "))]
    Name {
        /// The unknown name.
        name: String,
        /// Names of the lists that `unogen` writes.
        expected: Vec<String>,
    },
    /// A list would be empty.
    #[error("{place}: none of {targets} targets has a reference view for the list {list}")]
    NoReferences {
        /// Folder of the dataset.
        place: String,
        /// Name of the protocol.
        list: String,
        /// Number of targets, none of which has a reference.
        targets: usize,
    },
}
