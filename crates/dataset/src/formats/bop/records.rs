//! Entries of `scene_gt.json` and `scene_gt_info.json`, millimetres as in the files. Unknown fields are
//! ignored.

use serde::{Deserialize, Serialize};
use unopose_core::geometry::Pose;

use super::super::{
    FormatError,
    whole_numbers::{rounded, rounded_box, whole},
};

const MM_PER_METRE: f64 = 1000.0;

/// Pose of one instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GtRecord {
    /// Rotation from model to camera, row-major.
    #[serde(rename = "cam_R_m2c")]
    pub cam_r_m2c: [f64; 9],
    /// Translation from model to camera, millimetres.
    #[serde(rename = "cam_t_m2c")]
    pub cam_t_m2c: [f64; 3],
    /// Object id, that of the model's file.
    #[serde(deserialize_with = "whole")]
    pub obj_id: u32,
}

impl GtRecord {
    /// From a pose in metres.
    pub fn new(obj_id: u32, t_camera_object: &Pose) -> Self {
        Self {
            cam_r_m2c: t_camera_object.rotation_row_major(),
            cam_t_m2c: (t_camera_object.translation * MM_PER_METRE).into(),
            obj_id,
        }
    }

    /// Object to camera, metres; `place` stands in the message when the rotation is none.
    pub fn pose(&self, place: &str) -> Result<Pose, FormatError> {
        let pose = Pose::from_row_major(&self.cam_r_m2c, &self.cam_t_m2c.map(|mm| mm / MM_PER_METRE));
        // Written with few digits in some datasets.
        if pose.rotation_defect() < 1e-2 {
            Ok(pose)
        } else {
            let determinant = pose.rotation.determinant();
            let value = format!("{:?} (determinant {determinant:.3})", self.cam_r_m2c);
            let expected = "a rotation matrix, row-major: orthogonal, determinant 1";
            Err(FormatError::field(place, "cam_R_m2c", value, expected))
        }
    }
}

/// Visibility of one instance. Floats in the file are rounded where they stand for pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GtInfoRecord {
    /// x, y, width, height of the whole silhouette; -1 when it is outside the image.
    #[serde(default, deserialize_with = "rounded_box")]
    pub bbox_obj: [i32; 4],
    /// The same of the visible part.
    #[serde(default, deserialize_with = "rounded_box")]
    pub bbox_visib: [i32; 4],
    /// Pixels of the silhouette, also outside the image.
    #[serde(default, deserialize_with = "rounded")]
    pub px_count_all: u32,
    /// Pixels of the silhouette with a depth measurement.
    #[serde(default, deserialize_with = "rounded")]
    pub px_count_valid: u32,
    /// Visible pixels of the silhouette.
    #[serde(deserialize_with = "rounded")]
    pub px_count_visib: u32,
    /// `px_count_visib / px_count_all`.
    pub visib_fract: f64,
}
