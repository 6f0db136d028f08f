//! Camera files: one camera per file, or one per image as in `scene_camera.json`.

use std::path::Path;

use serde::{Deserialize, Serialize};
use unopose_core::geometry::{Intrinsics, Pose};

use super::{FormatError, files::read_json};

/// BOP's scale where neither the scene nor the dataset gives one, millimetres per unit of the depth image.
pub const BOP_DEPTH_SCALE: f64 = 1.0;

/// A camera entry as BOP writes it. Unknown fields are ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraRecord {
    /// Matrix of the intrinsics, row-major, pixels.
    #[serde(rename = "cam_K")]
    pub cam_k: [f64; 9],
    /// Millimetres per unit of the depth image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_scale: Option<f64>,
    /// Columns of the image, where the file has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Rows of the image, where the file has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Rotation from world to camera, row-major.
    #[serde(default, rename = "cam_R_w2c", skip_serializing_if = "Option::is_none")]
    pub cam_r_w2c: Option<[f64; 9]>,
    /// Translation from world to camera, millimetres.
    #[serde(default, rename = "cam_t_w2c", skip_serializing_if = "Option::is_none")]
    pub cam_t_w2c: Option<[f64; 3]>,
}

/// A checked camera: usable intrinsics, a positive depth scale where there is one.
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
        }
    }

    /// The checked camera; `place` (file and entry) stands in the message of what is wrong.
    pub fn check(&self, place: &str) -> Result<Camera, FormatError> {
        let intrinsics = Intrinsics::from_cam_k(&self.cam_k)
            .map_err(|source| FormatError::Intrinsics { place: place.to_owned(), source })?;
        if let Some(scale) = self.depth_scale.filter(|scale| !(scale.is_finite() && *scale > 0.0)) {
            return Err(FormatError::field(place, "depth_scale", scale, "a finite number above 0"));
        }
        let t_camera_world = match (&self.cam_r_w2c, &self.cam_t_w2c) {
            (Some(r), Some(t)) => Some(Pose::from_row_major(r, &t.map(|mm| mm / 1000.0))),
            _ => None,
        };
        let size = [self.width, self.height];
        Ok(Camera { intrinsics, depth_scale: self.depth_scale, size, t_camera_world })
    }
}

impl Camera {
    /// Millimetres per unit of the depth image: nothing stands for it where the file does not say, since a wrong unit gives
    /// confident poses at the wrong distance.
    pub fn require_depth_scale(&self, path: &Path) -> Result<f64, FormatError> {
        self.depth_scale.ok_or_else(|| {
            let hint = "millimetres per unit of the depth image: 1.0 for millimetres, 0.1 for tenths, 1000.0 for metres";
            FormatError::missing(path.display(), "depth_scale", hint)
        })
    }

    /// An error where the camera is one of images of another size.
    pub fn check_size(&self, place: &str, (width, height): (u32, u32)) -> Result<(), FormatError> {
        let [columns, rows] = [self.size[0].unwrap_or(width), self.size[1].unwrap_or(height)];
        if (columns, rows) == (width, height) {
            return Ok(());
        }
        let expected = format!("{width} x {height} like the image: intrinsics belong to one size");
        Err(FormatError::field(place, "image size", format!("{columns} x {rows}"), expected))
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
        depth_scale: Option<f64>,
        width: Option<u32>,
        height: Option<u32>,
    },
}

/// Reads a single-camera file: `{cam_K, depth_scale}`, or `{fx, fy, cx, cy, depth_scale}` as a dataset's
/// `camera.json`; both may have `width` and `height`.
pub fn read_camera(path: &Path) -> Result<Camera, FormatError> {
    let value: serde_json::Value = read_json(path)?;
    let misspelt = misspelt_scale(&value);
    let record = match serde_json::from_value::<CameraFile>(value) {
        Ok(CameraFile::Matrix(record)) => record,
        Ok(CameraFile::Fields { fx, fy, cx, cy, depth_scale, width, height }) => {
            let record = CameraRecord::new(&Intrinsics { fx, fy, cx, cy }, BOP_DEPTH_SCALE);
            CameraRecord { depth_scale, width, height, ..record }
        }
        Err(_) => {
            let hint = "expected 9 numbers cam_K and depth_scale, or fx, fy, cx, cy and depth_scale";
            return Err(FormatError::missing(path.display(), "camera", hint));
        }
    };
    match misspelt {
        Some(key) if record.depth_scale.is_none() => {
            let hint = format!(
                "{key} is unknown; its value in millimetres per unit of the depth image is expected there"
            );
            Err(FormatError::missing(path.display(), "depth_scale", hint))
        }
        _ => record.check(&path.display().to_string()),
    }
}

/// A key that may be meant as `depth_scale`.
fn misspelt_scale(value: &serde_json::Value) -> Option<String> {
    let letters =
        |key: &String| key.chars().filter(char::is_ascii_alphabetic).collect::<String>().to_lowercase();
    let meant = |key: &&String| {
        let letters = letters(key);
        let about = ["scale", "scal", "unit", "factor", "sclae"].iter().any(|word| letters.contains(word));
        *key != "depth_scale" && (letters.contains("depth") && about || letters == "scale")
    };
    value.as_object()?.keys().find(meant).cloned()
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
        let (a, b) = (a.unwrap(), b.unwrap());
        assert_eq!((a.intrinsics, a.depth_scale), (b.intrinsics, Some(0.1)));
        a.check_size("cam.json", (320, 240)).unwrap();
        b.check_size("cam.json", (640, 480)).unwrap();
        let message = b.check_size("cam.json", (320, 240)).unwrap_err().to_string();
        assert!(message.contains("640 x 240") && message.contains("320 x 240"), "{message}");
    }

    #[test]
    fn a_missing_scale_is_no_scale() {
        let path = Path::new("cam.json");
        let camera = read(r#"{"cam_K": [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#).unwrap();
        assert_eq!(camera.depth_scale, None);
        let message = camera.require_depth_scale(path).unwrap_err().to_string();
        assert!(message.contains("cam.json: depth_scale not found") && message.contains("0.1"), "{message}");
        for key in ["depthScale", "depth_scal", "Depth-Scale", "depth_units", "scale"] {
            let text = format!(r#"{{"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "{key}": 0.1}}"#);
            let message = read(&text).unwrap_err().to_string();
            assert!(message.contains("depth_scale not found") && message.contains(key), "{message}");
        }
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
