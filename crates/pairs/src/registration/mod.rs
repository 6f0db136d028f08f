//! Classical registration of two masked clouds, and local refinement of a pose from anywhere.
//!
//! [`PairEstimator`] is the one interface of everything that finds a pose between two masked views, the network
//! included; [`Refined`] puts a refinement after any of them. Clouds are `&[[f32; 3]]`, metres, camera frames.

mod align_center;
mod catalog;
mod error;
mod feature_pair;
mod fpfh;
mod fpfh_mac;
mod fpfh_ransac;
pub mod icp;
mod pair;
mod ppf;
mod pseudo_symmetry;
mod refinement;
mod surface;

pub use align_center::AlignCenter;
pub use catalog::{CLASSICAL_METHODS, classical_method};
pub use error::RegistrationError;
pub use fpfh::{Fpfh, fpfh, nearest_features};
pub use fpfh_mac::FpfhMac;
pub use fpfh_ransac::FpfhRansac;
pub use icp::{IcpOutcome, IcpReference, refine};
pub use pair::{CloudRegistration, PairEstimator, PairPose, Refined};
pub use ppf::Ppf;
pub use pseudo_symmetry::{Axis, PseudoSymmetries};
pub use refinement::Refinement;
pub use surface::Surface;

#[cfg(test)]
mod tests;
