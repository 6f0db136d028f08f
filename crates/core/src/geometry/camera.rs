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
    /// A finite number that no camera has.
    #[error("cam_K {name} is {value:?} px, expected {minimum:?} to {maximum:?} px{of_image}")]
    Range {
        /// `fx`, `fy`, `cx` or `cy`.
        name: &'static str,
        /// The value met, pixels.
        value: f64,
        /// Smallest value, pixels.
        minimum: f64,
        /// Largest value, pixels.
        maximum: f64,
        /// The size of the image that gives the range, in words; may be empty.
        of_image: String,
    },
}

/// Focal lengths of any camera, pixels.
const FOCAL_RANGE: [f64; 2] = [1e-2, 1e7];
/// Coordinates of any camera's principal point, pixels.
const PRINCIPAL_RANGE: [f64; 2] = [-1e7, 1e7];
/// Focal lengths in units of the image's longer side: fields of view from 169 degrees down to those of narrow crops.
const FOCAL_PER_SIDE: [f64; 2] = [0.05, 200.0];
/// How far outside the image the principal point may lie, in image sizes: that of a crop is far outside.
const PRINCIPAL_OUTSIDE: f64 = 20.0;

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
        let intrinsics = Self { fx: k[0], fy: k[4], cx: k[2], cy: k[5] };
        intrinsics.check_ranges(FOCAL_RANGE, [PRINCIPAL_RANGE; 2], "")?;
        Ok(intrinsics)
    }

    /// An error where no camera of images of `width` x `height` pixels is like this one, such as intrinsics in units of the
    /// image's width.
    pub fn check_image(&self, width: u32, height: u32) -> Result<(), IntrinsicsError> {
        let side = f64::from(width.max(height));
        let around = |size: u32| [-PRINCIPAL_OUTSIDE, PRINCIPAL_OUTSIDE + 1.0].map(|n| n * f64::from(size));
        let of_image = format!(" for an image of {width} x {height}");
        self.check_ranges(FOCAL_PER_SIDE.map(|n| n * side), [around(width), around(height)], &of_image)
    }

    fn check_ranges(
        &self,
        focal: [f64; 2],
        principal: [[f64; 2]; 2],
        of_image: &str,
    ) -> Result<(), IntrinsicsError> {
        let [x, y] = principal;
        let values = [("fx", self.fx, focal), ("fy", self.fy, focal), ("cx", self.cx, x), ("cy", self.cy, y)];
        match values.into_iter().find(|(_, value, [minimum, maximum])| !(minimum..=maximum).contains(&value))
        {
            None => Ok(()),
            Some((name, value, [minimum, maximum])) => {
                Err(IntrinsicsError::Range { name, value, minimum, maximum, of_image: of_image.to_owned() })
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absurd_intrinsics_are_named_with_their_range() {
        let camera = |[fx, fy, cx, cy]: [f64; 4]| [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
        for (values, part) in [
            ([600.0, 600.0, 1e308, 239.5], "cam_K cx is 1e308 px, expected -10000000.0 to 10000000.0 px"),
            ([1e-300, 600.0, 319.5, 239.5], "cam_K fx is 1e-300 px, expected 0.01 to"),
            ([600.0, 1e30, 319.5, 239.5], "cam_K fy is 1e30 px"),
            ([600.0, 600.0, 319.5, -1e9], "cam_K cy is -1000000000.0 px"),
        ] {
            let message = Intrinsics::from_cam_k(&camera(values)).unwrap_err().to_string();
            assert!(message.starts_with(part), "{message}");
        }
        for (values, part) in [
            // Units of the image's width.
            ([0.9, 0.9, 0.5, 0.37], "fx is 0.9 px, expected 32.0 to 128000.0 px for an image of 640 x 480"),
            ([600.0, 600.0, 13441.0, 239.5], "cx is 13441.0 px, expected -12800.0 to 13440.0 px"),
            ([600.0, 600.0, 319.5, -9601.0], "cy is -9601.0 px, expected -9600.0 to 10080.0 px"),
        ] {
            let intrinsics = Intrinsics::from_cam_k(&camera(values)).unwrap();
            let message = intrinsics.check_image(640, 480).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        let usable = [[600.0, 610.0, 319.5, 239.5], [6000.0, 6000.0, -1500.0, 2000.0]];
        for values in usable {
            Intrinsics::from_cam_k(&camera(values)).unwrap().check_image(640, 480).unwrap();
        }
    }
}
