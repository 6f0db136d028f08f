//! Where a view is taken from.

use unopose_core::geometry::{Intrinsics, Pose};

/// A pinhole camera in the world.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// World to camera, metres.
    pub t_camera_world: Pose,
    /// Focal lengths and principal point, pixels.
    pub intrinsics: Intrinsics,
    /// Columns of the image.
    pub width: u32,
    /// Rows of the image.
    pub height: u32,
}
