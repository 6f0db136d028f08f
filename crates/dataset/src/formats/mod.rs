//! Dataset files: BOP scene-wise folders, MegaPose webdataset shards, detections, targets, result tables.
//!
//! Millimetres live only in the structs that mirror the files; everything handed out is in metres.

pub mod bop;
pub mod camera;
pub mod detections;
mod error;
pub mod files;
mod foreground;
pub mod image_io;
pub mod megapose;
pub mod models;
mod numbered;
pub mod results;
pub mod rle;
mod sequence;
mod symmetry;
pub mod targets;
pub mod units;
mod whole_numbers;

pub use bop::{BopDataset, BopScene, BopSplit, DatasetSplits};
pub use error::FormatError;
pub use foreground::Foreground;
pub use models::ModelInfo;
pub use results::PoseResult;
pub use sequence::PhoneSequence;
pub use symmetry::{ObjectSymmetries, SymmetryAxis};
pub use targets::{ReferenceTarget, Target};

use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};

/// An annotated RGB-D image, the same whether it came from a BOP folder or a shard.
#[derive(Clone, Debug)]
pub struct AnnotatedFrame {
    /// Colour, depth (metres) and intrinsics.
    pub frame: RgbdFrame,
    /// In the order of the annotation file.
    pub instances: Vec<Instance>,
}

/// One object instance of an image.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Dataset-wide object id (MegaPose object names are mapped to their index in the models list).
    pub obj_id: u32,
    /// Object to camera.
    pub t_camera_object: Pose,
    /// Share of the object's silhouette that is visible, 0..1.
    pub visib_fract: f64,
    /// Number of visible pixels.
    pub px_count_visib: u32,
    /// Visible part.
    pub mask_visib: Mask,
}
