//! Pinhole intrinsics in pixels, OpenCV convention: x right, y down, z forward, pixel centres at integer coordinates.

use nalgebra::{Point3, Vector2};
use serde::{Deserialize, Serialize};

/// Pinhole camera without distortion. `u = fx x / z + cx`, `v = fy y / z + cy`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Column of the principal point, pixels.
    pub cx: f64,
    /// Row of the principal point, pixels.
    pub cy: f64,
}

/// Why a 3x3 camera matrix is not a usable pinhole camera.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum IntrinsicsError {
    /// An entry that is infinite or not a number.
    #[error("cam_K[{index}] is {value}, expected a finite number")]
    NotFinite {
        /// Row-major index of the entry, 0 to 8.
        index: usize,
        /// The value met.
        value: f64,
    },
    /// A focal length of 0 or less.
    #[error("cam_K focal length {name} is {value} px, expected a number above 0")]
    Focal {
        /// `fx` or `fy`.
        name: &'static str,
        /// The value met, pixels.
        value: f64,
    },
    /// An entry that a pinhole camera without skew has 0 or 1 for.
    #[error("cam_K[{index}] is {value}, expected {expected} (row-major [fx 0 cx 0 fy cy 0 0 1], no skew)")]
    Form {
        /// Row-major index of the entry, 0 to 8.
        index: usize,
        /// The value met.
        value: f64,
        /// 0 or 1.
        expected: f64,
    },
}

impl Intrinsics {
    /// From a row-major `cam_K` as BOP writes it.
    pub fn from_cam_k(k: &[f64; 9]) -> Result<Self, IntrinsicsError> {
        if let Some((index, &value)) = k.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(IntrinsicsError::NotFinite { index, value });
        }
        for (name, value) in [("fx", k[0]), ("fy", k[4])] {
            if value <= 0.0 {
                return Err(IntrinsicsError::Focal { name, value });
            }
        }
        for (index, expected) in [(1, 0.0), (3, 0.0), (6, 0.0), (7, 0.0), (8, 1.0)] {
            if (k[index] - expected).abs() > 1e-6 {
                return Err(IntrinsicsError::Form { index, value: k[index], expected });
            }
        }
        Ok(Self { fx: k[0], fy: k[4], cx: k[2], cy: k[5] })
    }

    /// Row-major `cam_K`.
    pub fn to_cam_k(&self) -> [f64; 9] {
        [self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0]
    }

    /// Pixel `(u, v)` = (column, row) of a point in front of the camera; `None` when `z <= 0`.
    pub fn project(&self, p: &Point3<f64>) -> Option<Vector2<f64>> {
        (p.z > 0.0).then(|| Vector2::new(self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }

    /// The point at depth `z` (along the optical axis, metres) seen at pixel `(u, v)`.
    pub fn back_project(&self, u: f64, v: f64, z: f64) -> Point3<f64> {
        Point3::new((u - self.cx) * z / self.fx, (v - self.cy) * z / self.fy, z)
    }
}
