//! Surface points that are shaded.

use nalgebra::Vector3;

use super::scene::Finish;

/// A surface point under a pixel or ray.
pub(super) struct Surfel {
    pub point: Vector3<f32>,
    pub normal: Vector3<f32>,
    pub albedo: [f32; 3],
    pub finish: Finish,
}

/// What a point belongs to: an object, or one flat side of the surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SurfaceKey {
    Object(u32),
    Room(Option<usize>, usize),
}
