//! Camera files: one camera per file, or one per image as in `scene_camera.json`.

use std::path::Path;

use serde::{Deserialize, Serialize};
use unopose_core::geometry::{Intrinsics, Pose};

use super::{FormatError, files::read_json};

/// A camera entry as BOP writes it. Unknown fields are ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraRecord {
    /// Matrix of the intrinsics, row-major, pixels.
    #[serde(rename = "cam_K")]
    pub cam_k: [f64; 9],
    /// Millimetres per unit of the depth image; absent where there is no depth.
    #[serde(default = "one")]
    pub depth_scale: f64,
    /// Rotation from world to camera, row-major.
    #[serde(default, rename = "cam_R_w2c", skip_serializing_if = "Option::is_none")]
    pub cam_r_w2c: Option<[f64; 9]>,
    /// Translation from world to camera, millimetres.
    #[serde(default, rename = "cam_t_w2c", skip_serializing_if = "Option::is_none")]
    pub cam_t_w2c: Option<[f64; 3]>,
}

fn one() -> f64 {
    1.0
}

/// A checked camera: usable intrinsics and a positive depth scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Focal lengths and principal point, pixels.
    pub intrinsics: Intrinsics,
    /// Millimetres per unit of the depth image.
    pub depth_scale: f64,
    /// World to camera, metres, where the file has it.
    pub t_camera_world: Option<Pose>,
}

impl CameraRecord {
    /// Without a pose; `depth_scale` in millimetres per unit of the depth image.
    pub fn new(intrinsics: &Intrinsics, depth_scale: f64) -> Self {
        Self { cam_k: intrinsics.to_cam_k(), depth_scale, cam_r_w2c: None, cam_t_w2c: None }
    }

    /// The checked camera; `place` (file and entry) stands in the message of what is wrong.
    pub fn check(&self, place: &str) -> Result<Camera, FormatError> {
        let intrinsics = Intrinsics::from_cam_k(&self.cam_k)
            .map_err(|source| FormatError::Intrinsics { place: place.to_owned(), source })?;
        if !(self.depth_scale.is_finite() && self.depth_scale > 0.0) {
            return Err(FormatError::field(
                place,
                "depth_scale",
                self.depth_scale,
                "a finite number above 0",
            ));
        }
        let t_camera_world = match (&self.cam_r_w2c, &self.cam_t_w2c) {
            (Some(r), Some(t)) => Some(Pose::from_row_major(r, &t.map(|mm| mm / 1000.0))),
            _ => None,
        };
        Ok(Camera { intrinsics, depth_scale: self.depth_scale, t_camera_world })
    }
}

/// The two forms of a single-camera file.
#[derive(Deserialize)]
#[serde(untagged)]
enum CameraFile {
    Matrix(CameraRecord),
    Fields {
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        #[serde(default = "one")]
        depth_scale: f64,
    },
}

/// Reads a single-camera file: `{cam_K, depth_scale}`, or `{fx, fy, cx, cy, depth_scale}` as a dataset's
/// `camera.json`.
pub fn read_camera(path: &Path) -> Result<Camera, FormatError> {
    let value: serde_json::Value = read_json(path)?;
    let record = match serde_json::from_value::<CameraFile>(value) {
        Ok(CameraFile::Matrix(record)) => record,
        Ok(CameraFile::Fields { fx, fy, cx, cy, depth_scale }) => {
            CameraRecord::new(&Intrinsics { fx, fy, cx, cy }, depth_scale)
        }
        Err(_) => {
            let hint = "expected 9 numbers cam_K and depth_scale, or fx, fy, cx, cy and depth_scale";
            return Err(FormatError::missing(path.display(), "camera", hint));
        }
    };
    record.check(&path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Camera, FormatError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cam.json");
        std::fs::write(&path, text).unwrap();
        read_camera(&path)
    }

    #[test]
    fn both_forms_give_the_same_camera() {
        let a = read(r#"{"cam_K": [600, 0, 319.5, 0, 601.0, 239.5, 0, 0, 1], "depth_scale": 0.1, "x": []}"#);
        let b =
            read(r#"{"fx": 600.0, "fy": 601, "cx": 319.5, "cy": 239.5, "depth_scale": 0.1, "width": 640}"#);
        assert_eq!(a.unwrap(), b.unwrap());
    }

    #[test]
    fn unusable_cameras_are_named() {
        for (text, part) in [
            (r#"{"cam_K": [0, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#, "fx is 0"),
            (r#"{"cam_K": [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1], "depth_scale": 0}"#, "depth_scale is 0"),
            (r#"{"cam_K": [NaN, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#, "line 1"),
            (r#"{"cam_K": [null, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#, "cam_K"),
            (r#"{"cam_K": [600, 0, 319.5, 0, 600]}"#, "9 numbers cam_K"),
            (r#"{"0": {"cam_K": [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}}"#, "camera not found"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains("cam.json") && message.contains(part), "{message}");
        }
    }
}
