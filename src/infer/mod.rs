//! Inference: from RGB-D views to poses.
//!
//! [`PoseEstimator`] is the way in: it loads a checkpoint, prepares a [`Reference`] once and estimates any number of
//! query instances against it. [`estimate_pairs`] and its relatives work on prepared pairs (training's validation
//! uses them), [`IcpReference`] refines a pose from any source, and [`estimate_targets`] runs the target list of a
//! BOP dataset. Every random number comes from the seed alone, so a pose does not depend on what else is estimated
//! with it.

mod assignments;
mod error;
mod estimator;
mod pairs;
mod reference;
mod refine;
mod target_references;
mod targets;
mod view_files;

pub use assignments::{Matched, host_assignments};
pub use error::InferError;
pub use estimator::{Estimate, PoseEstimator, Query, Timings};
pub use pairs::{
    EncodedReferences, PairEstimate, StageTimes, Uniforms, encode_references, estimate_encoded,
    estimate_pairs,
};
pub use reference::Reference;
pub use refine::{IcpOutcome, IcpReference, Refinement, refine, refine_with_outcome};
pub use targets::{Rejection, TargetFiles, TargetList, TargetPoses, estimate_targets};
pub use view_files::{View, ViewFiles, query_folder};
