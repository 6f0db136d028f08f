//! Rigid transforms. A variable named `t_a_b` holds the pose that maps coordinates in frame `b` to frame `a`.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// Rigid transform `x -> R x + t`, metres (or object radii where a doc says so).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation matrix R.
    pub rotation: Matrix3<f64>,
    /// Translation t.
    pub translation: Vector3<f64>,
}

impl Pose {
    /// The pose that moves nothing.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// From a rotation matrix, which is not checked, and a translation.
    pub fn new(rotation: Matrix3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// From a row-major rotation and a translation (metres).
    pub fn from_row_major(r: &[f64; 9], t: &[f64; 3]) -> Self {
        Self::new(Matrix3::from_row_slice(r), Vector3::from_row_slice(t))
    }

    /// Row-major rotation.
    pub fn rotation_row_major(&self) -> [f64; 9] {
        let m = &self.rotation;
        std::array::from_fn(|i| m[(i / 3, i % 3)])
    }

    /// World to camera (z forward, y down) of a camera at `position` that looks at `target`, the world's z pointing up in
    /// its image, turned by `roll` radians about its axis.
    pub fn looking_at(position: &Vector3<f64>, target: &Vector3<f64>, roll: f64) -> Self {
        let z = (target - position).normalize();
        let x = z.cross(&Vector3::z()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let y = z.cross(&x);
        let (s, c) = roll.sin_cos();
        let (right, down) = (x * c + y * s, y * c - x * s);
        let rotation = Matrix3::from_rows(&[right.transpose(), down.transpose(), z.transpose()]);
        Self::new(rotation, -(rotation * position))
    }

    /// `t_b_a` of `t_a_b`.
    pub fn inverse(&self) -> Self {
        let r = self.rotation.transpose();
        Self::new(r, -(r * self.translation))
    }

    /// The point's coordinates in the target frame, `R p + t`.
    pub fn transform(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords + self.translation)
    }

    /// [`Self::transform`] of single-precision coordinates.
    pub fn transform_f32(&self, p: &[f32; 3]) -> [f32; 3] {
        let q = self.rotation * Vector3::new(p[0] as f64, p[1] as f64, p[2] as f64) + self.translation;
        [q.x as f32, q.y as f32, q.z as f32]
    }

    /// Geodesic angle between two rotations, degrees in [0, 180].
    pub fn rotation_angle_deg(&self, other: &Self) -> f64 {
        // atan2 of the quaternion's parts is accurate at both ends, unlike acos of the trace.
        let r = Rotation3::from_matrix_unchecked(self.rotation.transpose() * other.rotation);
        let q = nalgebra::UnitQuaternion::from_rotation_matrix(&r);
        2.0 * q.imag().norm().atan2(q.scalar().abs()).to_degrees()
    }

    /// Distance between the two translations, in their unit.
    pub fn translation_distance(&self, other: &Self) -> f64 {
        (self.translation - other.translation).norm()
    }

    /// Largest entry of `|R^T R - I|` and of `|det R - 1|`; small for a proper rotation.
    pub fn rotation_defect(&self) -> f64 {
        let gram = self.rotation.transpose() * self.rotation - Matrix3::identity();
        gram.abs().max().max((self.rotation.determinant() - 1.0).abs())
    }
}

/// `t_a_b * t_b_c = t_a_c`.
impl std::ops::Mul for Pose {
    type Output = Pose;
    fn mul(self, rhs: Pose) -> Pose {
        Pose::new(self.rotation * rhs.rotation, self.rotation * rhs.translation + self.translation)
    }
}
