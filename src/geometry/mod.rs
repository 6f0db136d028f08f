//! Geometry on plain point slices: cameras, poses, sampling, reference frames, neighbours, registration.
//!
//! Knows no tensors and no files. Clouds are `&[[f32; 3]]`, poses are `f64`.

mod camera;
mod pose;

pub use camera::{Intrinsics, IntrinsicsError};
pub use pose::Pose;
