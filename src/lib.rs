//! One-reference 6-DoF pose estimation of unseen objects (UNOPose, CVPR 2025).
//!
//! One RGB-D view of an object with a mask is the reference; [`PoseEstimator`] finds the pose of the same object in other
//! views. No CAD model, no known pose. Everything is in metres, in camera frames with x to the right, y down and z forward.
//!
//! ```no_run
//! use unopose::{DeviceChoice, PoseEstimator, Refinement, ViewFiles};
//!
//! # fn main() -> Result<(), unopose::Error> {
//! let view = |name: &str| ViewFiles {
//!     rgb: format!("{name}/rgb.png").into(),
//!     depth: format!("{name}/depth.png").into(),
//!     masks: vec![format!("{name}/mask.png").into()],
//!     camera: "camera.json".into(),
//!     depth_scale: None,
//! };
//! let (reference, query) = (view("reference").read()?, view("query").read()?);
//!
//! let estimator = PoseEstimator::load_default(DeviceChoice::Auto)?.with_refinement(Refinement::Icp);
//! // Once per object, for any number of queries.
//! let reference = estimator.reference(&reference.frame, &reference.masks[0])?;
//! for estimate in estimator.estimate(&reference, &query.frame, &query.masks) {
//!     let estimate = estimate?;
//!     println!("{:?} score {:.2}", estimate.t_query_reference, estimate.score);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! The names below are the stable surface. The crates that they come from (`unopose-core`, `unopose-infer` and so on) hold
//! everything else, training and benchmarks included, and change with every version; `docs/architecture.md` draws them.

pub use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::{Intrinsics, Pose},
};
pub use unopose_infer::{
    Confidence, Estimate, InferError as Error, PoseEstimator, Reference, Refinement, View, ViewFiles,
};
pub use unopose_nn::device::DeviceChoice;
// Types of these crates are part of the surface: colour images and matrices.
pub use image;
pub use nalgebra;
