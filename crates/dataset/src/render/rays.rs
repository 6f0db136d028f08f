//! Viewing rays.

use nalgebra::Vector3;
use unopose_core::geometry::Intrinsics;

use super::camera::Camera;

/// Viewing rays in the world; `origin + z * direction` lies at depth z.
pub(super) struct Rays {
    pub origin: Vector3<f32>,
    /// Direction at (0, 0), and its change from column to column and from row to row.
    corner: Vector3<f32>,
    right: Vector3<f32>,
    down: Vector3<f32>,
}

impl Rays {
    /// `intrinsics` may be those of a finer raster than the camera's.
    pub fn new(camera: &Camera, intrinsics: &Intrinsics) -> Self {
        let t_world_camera = camera.t_camera_world.inverse();
        let rotation = t_world_camera.rotation;
        let corner = rotation * intrinsics.back_project(0.0, 0.0, 1.0).coords;
        Self {
            origin: t_world_camera.translation.cast(),
            corner: corner.cast(),
            right: (rotation.column(0) / intrinsics.fx).cast(),
            down: (rotation.column(1) / intrinsics.fy).cast(),
        }
    }

    pub fn direction(&self, col: u32, row: u32) -> Vector3<f32> {
        self.corner + self.right * col as f32 + self.down * row as f32
    }
}
