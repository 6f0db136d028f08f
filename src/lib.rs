//! One-reference 6-DoF pose estimation of unseen objects (UNOPose, CVPR 2025): training and inference.
//!
//! One RGB-D view of an object with a mask is the reference; [`infer::PoseEstimator`] finds the pose of the same object
//! in other views. Rooms, and the direction of the data through them, are in `docs/architecture.md`.
//!
//! ```no_run
//! use unopose::{
//!     device::DeviceChoice,
//!     infer::{PoseEstimator, ViewFiles},
//! };
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let view = |name: &str| ViewFiles {
//!     rgb: format!("{name}/rgb.png").into(),
//!     depth: format!("{name}/depth.png").into(),
//!     masks: vec![format!("{name}/mask.png").into()],
//!     camera: "camera.json".into(),
//! };
//! let (reference, query) = (view("reference").read()?, view("query").read()?);
//!
//! let estimator = PoseEstimator::load_default(DeviceChoice::Auto)?;
//! let reference = estimator.reference(&reference.frame, &reference.masks[0])?;
//! for estimate in estimator.estimate(&reference, &query.frame, &query.masks) {
//!     let estimate = estimate?;
//!     println!("{:?} score {:.2}", estimate.t_query_reference, estimate.score);
//! }
//! # Ok(())
//! # }
//! ```

pub mod analysis;
pub mod bench;
pub mod checkpoint;
pub mod config;
pub mod data;
pub mod device;
pub mod eval;
pub mod formats;
pub mod frame;
pub mod geometry;
pub mod infer;
pub mod loss;
pub mod mesh;
pub mod model;
pub mod protocol;
pub mod registration;
pub mod render;
pub mod report;
pub mod segment;
pub mod simd;
pub mod synth;
pub mod train;
pub mod verify;
