//! A camera as BOP writes it, and what is left of it once it is checked.

use std::{ops::RangeInclusive, path::Path};

use serde::{Deserialize, Deserializer, Serialize, de::Error};
use serde_json::{Map, Value};
use unopose_core::{
    frame::Undistortion,
    geometry::{Distortion, Intrinsics, Pose},
};

use super::{super::FormatError, fields::Fields};

/// BOP's scale where neither the scene nor the dataset gives one, millimetres per unit of the depth image.
pub const BOP_DEPTH_SCALE: f64 = 1.0;

/// Depth scales that a camera may have, millimetres per unit: from a range of 13 cm in 16 bits to metres.
pub const DEPTH_SCALES: RangeInclusive<f64> = 0.002..=1000.0;

/// Least share of the undistorted image that the distorted one has to show.
const MIN_COVERED: f64 = 0.5;

/// A camera entry. It is written as BOP does and read in any form of an object; unknown fields are ignored.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraRecord {
    /// Matrix of the intrinsics, row-major, pixels.
    #[serde(rename = "cam_K")]
    pub cam_k: [f64; 9],
    /// Millimetres per unit of the depth image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_scale: Option<f64>,
    /// Columns of the image, where the file has them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Rows of the image, where the file has them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Rotation from world to camera, row-major.
    #[serde(rename = "cam_R_w2c", skip_serializing_if = "Option::is_none")]
    pub cam_r_w2c: Option<[f64; 9]>,
    /// Translation from world to camera, millimetres.
    #[serde(rename = "cam_t_w2c", skip_serializing_if = "Option::is_none")]
    pub cam_t_w2c: Option<[f64; 3]>,
    /// Distortion of the lens, where the file has one that is not zero.
    #[serde(skip)]
    pub distortion: Option<Distortion>,
}

impl<'de> Deserialize<'de> for CameraRecord {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let object = Map::<String, Value>::deserialize(deserializer)?;
        Fields::new(&object, "camera").record().map_err(D::Error::custom)
    }
}

/// A checked camera: usable intrinsics, a plausible depth scale where there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Focal lengths and principal point, pixels.
    pub intrinsics: Intrinsics,
    /// Millimetres per unit of the depth image; `None` where the file does not say.
    pub depth_scale: Option<f64>,
    /// Columns and rows of the image, each where the file has it.
    size: [Option<u32>; 2],
    /// World to camera, metres, where the file has it.
    pub t_camera_world: Option<Pose>,
    distortion: Option<Distortion>,
}

impl CameraRecord {
    /// Without a pose; `depth_scale` in millimetres per unit of the depth image.
    pub fn new(intrinsics: &Intrinsics, depth_scale: f64) -> Self {
        Self {
            cam_k: intrinsics.to_cam_k(),
            depth_scale: Some(depth_scale),
            width: None,
            height: None,
            cam_r_w2c: None,
            cam_t_w2c: None,
            distortion: None,
        }
    }

    /// The checked camera of an image of a dataset, whose images are those of pinhole cameras; `place` (file and entry) stands in
    /// the message of what is wrong.
    pub fn check(&self, place: &str) -> Result<Camera, FormatError> {
        if let Some(Distortion { radial, tangential }) = self.distortion {
            let value = format!("{radial:?}, {tangential:?}");
            let expected = "all 0: images of datasets are undistorted ones";
            return Err(FormatError::field(place, "lens distortion", value, expected));
        }
        self.check_with_lens(place)
    }

    /// [`Self::check`] of a camera whose images may be distorted.
    pub(super) fn check_with_lens(&self, place: &str) -> Result<Camera, FormatError> {
        let wrong = |source| FormatError::Intrinsics { place: place.to_owned(), source };
        let intrinsics = Intrinsics::from_cam_k(&self.cam_k).map_err(wrong)?;
        if let (Some(width), Some(height)) = (self.width, self.height) {
            intrinsics.check_image(width, height).map_err(wrong)?;
        }
        if let Some(scale) = self.depth_scale.filter(|scale| !DEPTH_SCALES.contains(scale)) {
            let expected = format!(
                "{} to {} millimetres per unit (0.001 metres are 1.0)",
                DEPTH_SCALES.start(),
                DEPTH_SCALES.end()
            );
            return Err(FormatError::field(place, "depth_scale", format!("{scale:?}"), expected));
        }
        let t_camera_world = match (&self.cam_r_w2c, &self.cam_t_w2c) {
            (Some(r), Some(t)) => Some(Pose::from_row_major(r, &t.map(|mm| mm / 1000.0))),
            _ => None,
        };
        let (size, distortion) = ([self.width, self.height], self.distortion);
        Ok(Camera { intrinsics, depth_scale: self.depth_scale, size, t_camera_world, distortion })
    }
}

impl Camera {
    /// Millimetres per unit of the depth image: nothing stands for it where the file does not say, since a wrong unit gives
    /// confident poses at the wrong distance.
    pub fn require_depth_scale(&self, path: &Path) -> Result<f64, FormatError> {
        self.depth_scale.ok_or_else(|| {
            let hint = "millimetres per unit of the depth image: 1.0 for millimetres, 0.1 for tenths, 1000.0 for metres; \
                        --depth-scale gives it for files without";
            FormatError::missing(path.display(), "depth_scale", hint)
        })
    }

    /// An error where the camera is not one of images of this size: its file says another one, or its intrinsics are absurd
    /// for it.
    pub fn check_size(&self, place: &str, (width, height): (u32, u32)) -> Result<(), FormatError> {
        let [columns, rows] = [self.size[0].unwrap_or(width), self.size[1].unwrap_or(height)];
        if (columns, rows) != (width, height) {
            let expected = format!("{width} x {height} like the image: intrinsics belong to one size");
            return Err(FormatError::field(place, "image size", format!("{columns} x {rows}"), expected));
        }
        let wrong = |source| FormatError::Intrinsics { place: place.to_owned(), source };
        self.intrinsics.check_image(width, height).map_err(wrong)
    }

    /// What turns the camera's images of this size into those of a pinhole camera; `None` where the lens does not distort.
    pub fn undistortion(
        &self,
        place: &str,
        (width, height): (u32, u32),
    ) -> Result<Option<Undistortion>, FormatError> {
        let Some(distortion) = &self.distortion else { return Ok(None) };
        let map = Undistortion::new(&self.intrinsics, distortion, width, height);
        let covered = map.covered();
        if covered < MIN_COVERED {
            let value = format!("one that leaves {:.0} % of the image", 100.0 * covered);
            let expected = format!(
                "at least {:.0} %: {:?} and {:?} are no coefficients of this image's lens",
                100.0 * MIN_COVERED,
                distortion.radial,
                distortion.tangential
            );
            return Err(FormatError::field(place, "lens distortion", value, expected));
        }
        Ok(Some(map))
    }
}
