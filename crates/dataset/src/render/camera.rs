//! Where a view is taken from.

use unopose_core::geometry::{Intrinsics, Pose};

/// A pinhole camera in the world.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    pub t_camera_world: Pose,
    pub intrinsics: Intrinsics,
    pub width: u32,
    pub height: u32,
}
