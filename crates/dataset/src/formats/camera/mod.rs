//! Camera files: one camera per file in any of the forms that cameras and their tools write, or one per image as in
//! `scene_camera.json`.
//!
//! | form | what it is known by |
//! |--|--|
//! | BOP | `cam_K` (9 numbers row by row, or 3 rows), `depth_scale`; a `scene_camera.json` of equal cameras |
//! | a dataset's `camera.json` | `fx`, `fy`, `cx`, `cy`, `depth_scale` |
//! | RealSense | `fx`, `fy`, `ppx`, `ppy`, `model`, `coeffs` |
//! | Open3D | `intrinsic_matrix` column by column |
//! | ROS, OpenCV (YAML) | `camera_matrix` with `data`, or `K`; `image_width`, `distortion_model`, `D` |
//! | text | 9 numbers, row by row (`cam_K.txt`) |
//!
//! Numbers may be strings. Lens distortion is kept with the camera, and [`Camera::undistortion`] undoes it.

mod fields;
mod file;
mod lens;
mod record;

#[cfg(test)]
mod tests;

pub use file::{read_camera, read_camera_scaled};
pub use record::{BOP_DEPTH_SCALE, Camera, CameraRecord, DEPTH_SCALES};
