//! Inference: from RGB-D views to poses.
//!
//! [`PoseEstimator`] is the way in: it loads a checkpoint, prepares a [`Reference`] once and estimates any number of
//! query instances against it. [`estimate_pairs`] and its relatives work on prepared pairs (training's validation
//! uses them), and [`estimate_targets`] runs the target list of a BOP dataset. Every random number comes from the seed alone, so a pose does not depend on what else is estimated
//! with it.

mod assignments;
mod error;
mod estimator;
mod one_pair;
mod pairs;
mod reference;
mod target_list;
mod target_references;
mod targets;
mod uniforms;
mod view_files;

pub use assignments::{Matched, host_assignments};
pub use error::InferError;
pub use estimator::{Estimate, PoseEstimator, Query, Timings};
pub use pairs::{
    EncodedReferences, PairEstimate, StageTimes, encode_references, estimate_encoded, estimate_pairs,
};
pub use reference::Reference;
pub use target_list::{Rejection, TargetFiles, TargetList, TargetPoses, next_detections};
pub use targets::estimate_targets;
pub use uniforms::Uniforms;
pub use view_files::{View, ViewFiles, query_folder};

pub use crate::registration::{IcpOutcome, IcpReference, Refinement, refine};
