//! What can go wrong when results are scored.

use unopose_dataset::{formats::FormatError, mesh::MeshError};

/// Why poses or detections could not be scored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// A file of the dataset, of the targets or of the results.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// An evaluation model.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A target's object without an entry in `models_info.json`.
    #[error("{file}: object {obj_id} not found, but it is among the targets")]
    UnknownObject {
        /// `models_info.json`.
        file: String,
        /// Object id of the target.
        obj_id: u32,
    },
    /// A target whose image has no annotated instance of its object.
    #[error(
        "{scene}: image {im_id} is a target for object {obj_id}, but scene_gt.json has no instance of it"
    )]
    TargetWithoutGt {
        /// Folder of the scene.
        scene: String,
        /// Image id of the target.
        im_id: u32,
        /// Object id of the target.
        obj_id: u32,
    },
    /// Targets whose poses are kept secret, as in the test images of some datasets.
    #[error("{file}: no annotation of the targets' images: nothing to score with")]
    NoAnnotations {
        /// `scene_gt.json` of the first of them, which is absent or lacks the image.
        file: String,
    },
    /// A table of which no pose belongs to a target.
    #[error("{file}: {problem}")]
    NoResultOfTargets {
        /// The table.
        file: String,
        /// The ids that differ.
        problem: String,
    },
    /// No image of the targets could be read.
    #[error("none of {images} images can be scored: {first}")]
    NothingRead {
        /// Number of images of the targets.
        images: usize,
        /// What is wrong with the first.
        first: String,
    },
    /// An empty list of targets.
    #[error("no targets to score")]
    NoTargets,
}
