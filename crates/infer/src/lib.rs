//! Inference: from RGB-D views to poses.
//!
//! [`PoseEstimator`] is the way in: it loads a checkpoint, prepares a [`Reference`] once and estimates any number of
//! query instances against it. [`estimate_pairs`] and its relatives work on prepared pairs (training's validation
//! uses them), and [`estimate_targets`] runs the target list of a BOP dataset. Every random number comes from the seed alone, so a pose does not depend on what else is estimated
//! with it.

mod assignments;
mod choice;
mod color_features;
mod confidence;
mod error;
mod estimate;
mod estimator;
pub mod experiment;
mod forward;
mod judge;
mod one_pair;
mod pairs;
mod point_features;
mod recently_used;
mod reference;
mod reference_file;
mod settings;
mod streams;
mod target_references;
mod targets;
mod trace;
mod uniforms;
mod view_files;

pub use assignments::{Matched, host_assignments};
use choice::Choice;
pub use confidence::{
    Calibration, Confidence, Evidence, Feature, PoseCriterion, Reason, ReasonKind, Term, logistic_regression,
};
pub use error::InferError;
pub use estimate::{Alternative, Estimate, Query, Timings, Trace};
pub use estimator::PoseEstimator;
pub use forward::{estimate_encoded, estimate_pairs, trace_encoded};
use judge::{Candidate, Judge};
pub use pairs::{CloudPair, PairEstimate, StageTimes, encode_references};
pub use reference::Reference;
pub use target_references::{PosedReference, TargetReferences};
pub use targets::estimate_targets;
pub use trace::{FineTrace, PairTrace, sparse_points};
pub use uniforms::Uniforms;
pub use view_files::{View, ViewFiles, ViewRole, query_folder};

pub use unopose_pairs::registration::{IcpOutcome, IcpReference, Refinement, icp::refine_with, refine};
