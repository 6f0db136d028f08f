//! Why lists cannot be made.

use crate::{formats::FormatError, mesh::MeshError};

/// Error of the `protocol` room.
#[derive(Debug, thiserror::Error)]
pub enum ProtocolError {
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("unknown list {name:?}, expected one of {}", .expected.join(", "))]
    Name { name: String, expected: Vec<String> },
    #[error("{place}: none of {targets} targets has a reference view for the list {list}")]
    NoReferences { place: String, list: String, targets: usize },
}
