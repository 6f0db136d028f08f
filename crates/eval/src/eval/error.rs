//! What can go wrong when results are scored.

use unopose_dataset::{formats::FormatError, mesh::MeshError};

/// Error of the `eval` room.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("{file}: object {obj_id} not found, but it is among the targets")]
    UnknownObject { file: String, obj_id: u32 },
    #[error(
        "{scene}: image {im_id} is a target for object {obj_id}, but scene_gt.json has no instance of it"
    )]
    TargetWithoutGt { scene: String, im_id: u32, obj_id: u32 },
    #[error("no targets to score")]
    NoTargets,
}
