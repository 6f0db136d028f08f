//! A shape before it has colours.

use nalgebra::{Matrix3, Rotation3, Vector3};
use unopose_dataset::mesh::TriangleMesh;

/// Rotations about z (and half turns) that map a shape onto itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Symmetry {
    /// Every rotation about z.
    pub continuous: bool,
    /// Rotations by multiples of 360 / folds degrees about z; 0 and 1 mean none.
    pub folds: u32,
    /// The half turn about x.
    pub flip: bool,
}

impl Symmetry {
    /// Every rotation about z.
    pub(super) fn axis(flip: bool) -> Self {
        Self { continuous: true, folds: 0, flip }
    }

    /// `folds` rotations about z.
    pub(super) fn folds(folds: u32) -> Self {
        Self { continuous: false, folds, flip: false }
    }

    /// No symmetry at all.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// A closed surface with shared vertices (no normals, no texture coordinates yet).
#[derive(Clone, Debug, Default)]
pub(crate) struct Solid {
    pub mesh: TriangleMesh,
    /// Part number per vertex, for colouring.
    pub parts: Vec<u8>,
    pub symmetry: Symmetry,
}

impl Solid {
    /// Adds a vertex and returns its index.
    pub(super) fn push(&mut self, point: Vector3<f32>, part: u8) -> u32 {
        self.mesh.vertices.push(point.into());
        self.parts.push(part);
        self.parts.len() as u32 - 1
    }

    /// Adds another closed surface; the two may overlap.
    pub(super) fn append(&mut self, other: &Solid) {
        let offset = self.mesh.vertices.len() as u32;
        self.mesh.vertices.extend(&other.mesh.vertices);
        self.mesh.faces.extend(other.mesh.faces.iter().map(|f| f.map(|i| i + offset)));
        self.parts.extend(&other.parts);
    }

    /// Moves every vertex.
    pub(super) fn map(mut self, f: impl Fn(Vector3<f32>) -> Vector3<f32>) -> Self {
        for v in &mut self.mesh.vertices {
            *v = f(Vector3::from(*v)).into();
        }
        self
    }

    /// Translated.
    pub(super) fn moved(self, by: Vector3<f32>) -> Self {
        self.map(|p| p + by)
    }

    /// Rotated about `axis` through the origin.
    pub(super) fn turned(self, axis: Vector3<f32>, degrees: f32) -> Self {
        let r: Matrix3<f32> = *Rotation3::from_scaled_axis(axis * degrees.to_radians()).matrix();
        self.map(|p| r * p)
    }
}
