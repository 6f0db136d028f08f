//! Phone sequences in the layout of WildRGB-D: one static object, `rgb/`, `depth/` (millimetres, or floats in metres) and `masks/` with a file
//! per frame, `metadata` with the camera (`K`, column-major) and `cam_poses.txt` (frame number and the 4x4 matrix camera to
//! world, metres, row-major).

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use nalgebra::Vector3;
use serde::Deserialize;
use unopose_core::{
    files::read_text,
    frame::{Mask, RgbdFrame},
    geometry::{Intrinsics, Pose},
};

use super::{
    FormatError,
    files::read_json,
    image_io::{read_depth, read_mask, read_rgb},
    numbered::id_of,
    whole_numbers::some_whole,
};

/// Millimetres per unit of the depth images.
const DEPTH_SCALE: f64 = 1.0;

/// Bytes of the largest list of camera poses.
const MAX_POSES: u64 = 1 << 30;

/// A sequence with a camera pose per frame.
#[derive(Clone, Debug)]
pub struct PhoneSequence {
    folder: PathBuf,
    intrinsics: Intrinsics,
    /// Columns and rows that the camera is of.
    size: [Option<u32>; 2],
    frames: BTreeMap<u32, SequenceFrame>,
}

#[derive(Clone, Debug)]
struct SequenceFrame {
    rgb: PathBuf,
    depth: PathBuf,
    mask: PathBuf,
    t_world_camera: Pose,
}

#[derive(Deserialize)]
struct Metadata {
    #[serde(rename = "K")]
    k: Vec<f64>,
    /// Columns and rows of the colour images, where the file has them.
    #[serde(default, deserialize_with = "some_whole")]
    w: Option<u32>,
    #[serde(default, deserialize_with = "some_whole")]
    h: Option<u32>,
}

impl PhoneSequence {
    /// Finds the frames that have colour, depth, a mask and a camera pose.
    pub fn open(folder: &Path) -> Result<Self, FormatError> {
        let (intrinsics, size) = camera(&folder.join("metadata"))?;
        let [rgb, depth, masks] = ["rgb", "depth", "masks"].map(|name| numbered_files(&folder.join(name)));
        let (mut rgb, mut depth, mut masks) = (rgb?, depth?, masks?);
        let mut frames = BTreeMap::new();
        for (id, t_world_camera) in camera_poses(&folder.join("cam_poses.txt"))? {
            if let (Some(rgb), Some(depth), Some(mask)) =
                (rgb.remove(&id), depth.remove(&id), masks.remove(&id))
            {
                frames.insert(id, SequenceFrame { rgb, depth, mask, t_world_camera });
            }
        }
        if frames.is_empty() {
            let hint = "a frame has files in rgb/, depth/ and masks/ and a line in cam_poses.txt";
            return Err(FormatError::missing(folder.display(), "frames", hint));
        }
        Ok(Self { folder: folder.to_path_buf(), intrinsics, size, frames })
    }

    /// Last part of the folder's path.
    pub fn name(&self) -> String {
        self.folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Sorted.
    pub fn frame_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.frames.keys().copied()
    }

    /// A frame with the mask of the object.
    pub fn load(&self, id: u32) -> Result<(RgbdFrame, Mask), FormatError> {
        let entry = self.entry(id)?;
        let (rgb, depth) = (read_rgb(&entry.rgb)?, read_depth(&entry.depth, DEPTH_SCALE)?);
        let mask = read_mask(&entry.mask)?;
        let expected = format!("that of the colour image, {} x {}", rgb.width(), rgb.height());
        let size = (self.size[0].unwrap_or(rgb.width()), self.size[1].unwrap_or(rgb.height()));
        if size != rgb.dimensions() {
            let (place, size) = (self.folder.join("metadata"), format!("{} x {}", size.0, size.1));
            let expected = format!("{expected} ({})", entry.rgb.display());
            return Err(FormatError::field(place.display(), "size", size, expected));
        }
        for (path, size) in
            [(&entry.depth, (depth.width, depth.height)), (&entry.mask, (mask.width, mask.height))]
        {
            if size != rgb.dimensions() {
                let size = format!("{} x {}", size.0, size.1);
                return Err(FormatError::field(path.display(), "size", size, expected));
            }
        }
        Ok((RgbdFrame { rgb, depth, intrinsics: self.intrinsics }, mask))
    }

    /// Camera of frame `b` to camera of frame `a`: what the static object's pose between them is.
    pub fn relative_pose(&self, a: u32, b: u32) -> Result<Pose, FormatError> {
        Ok(self.entry(a)?.t_world_camera.inverse() * self.entry(b)?.t_world_camera)
    }

    fn entry(&self, id: u32) -> Result<&SequenceFrame, FormatError> {
        self.frames.get(&id).ok_or_else(|| {
            let hint = match (self.frames.keys().next(), self.frames.keys().next_back()) {
                (Some(first), Some(last)) => format!("{} frames, {first} to {last}", self.frames.len()),
                _ => String::new(),
            };
            FormatError::missing(self.folder.display(), format!("frame {id}"), hint)
        })
    }
}

fn camera(path: &Path) -> Result<(Intrinsics, [Option<u32>; 2]), FormatError> {
    let Metadata { k, w, h } = read_json(path)?;
    let wrong = |expected: &str| Err(FormatError::field(path.display(), "K", format!("{k:?}"), expected));
    let Ok([fx, _, k20, _, fy, k21, cx, cy, k22]) = <[f64; 9]>::try_from(k.as_slice()) else {
        return wrong("9 numbers, column-major");
    };
    if [k20, k21, k22] != [0.0, 0.0, 1.0] {
        return wrong("fx, 0, 0, s, fy, 0, cx, cy, 1: column by column");
    }
    let rows = [fx, 0.0, cx, 0.0, fy, cy, k20, k21, k22];
    let intrinsics = Intrinsics::from_cam_k(&rows)
        .map_err(|source| FormatError::Intrinsics { place: path.display().to_string(), source })?;
    Ok((intrinsics, [w, h]))
}

/// Files of a folder whose names are numbers.
fn numbered_files(folder: &Path) -> Result<BTreeMap<u32, PathBuf>, FormatError> {
    let entries = std::fs::read_dir(folder).map_err(|e| FormatError::io(folder, e))?;
    let mut files = BTreeMap::new();
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let Some(id) = path.file_stem().and_then(|stem| id_of(stem.to_str()?)) else { continue };
        if let Some(other) = files.insert(id, path) {
            let expected = "one file per frame";
            let value = format!("{} and another file", other.display());
            return Err(FormatError::field(folder.display(), format!("frame {id}"), value, expected));
        }
    }
    Ok(files)
}

fn camera_poses(path: &Path) -> Result<BTreeMap<u32, Pose>, FormatError> {
    let text = read_text(path, MAX_POSES).map_err(|e| FormatError::io(path, e))?;
    let mut poses = BTreeMap::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let place = || format!("{}: line {}", path.display(), index + 1);
        let wrong = |expected: &str| FormatError::field(place(), "line", line.trim(), expected);
        let mut words = line.split_whitespace();
        let id = words.next().and_then(id_of);
        let numbers: Option<Vec<f64>> =
            words.map(|word| word.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let (Some(id), Some(Ok(m))) = (id, numbers.map(<[f64; 16]>::try_from)) else {
            return Err(wrong("a frame number and 16 finite numbers"));
        };
        let rotation = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        let pose = Pose::from_row_major(&rotation, &Vector3::new(m[3], m[7], m[11]).into());
        let last_row = m[12..15].iter().all(|v| v.abs() < 1e-6) && (m[15] - 1.0).abs() < 1e-6;
        if pose.rotation_defect() > 1e-2 || !last_row {
            return Err(wrong("a rigid 4x4 matrix, row-major"));
        }
        if poses.insert(id, pose).is_some() {
            return Err(wrong("a frame that no earlier line has"));
        }
    }
    Ok(poses)
}

#[cfg(test)]
mod tests {
    use unopose_core::frame::DepthMap;

    use super::*;
    use crate::formats::image_io::{write_depth, write_mask, write_rgb};

    const IDENTITY: &str = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1";

    fn write(folder: &Path, poses: &str) {
        std::fs::write(folder.join("metadata"), r#"{"w": 4, "h": 3, "K": [50, 0, 0, 0, 60, 0, 1.5, 1, 1]}"#)
            .unwrap();
        std::fs::write(folder.join("cam_poses.txt"), poses).unwrap();
        let mut mask = Mask::empty(4, 3);
        mask.data[5] = true;
        for id in [0, 7] {
            write_rgb(&folder.join(format!("rgb/{id:05}.png")), &image::RgbImage::new(4, 3)).unwrap();
            let depth = DepthMap { width: 4, height: 3, data: vec![0.75; 12] };
            write_depth(&folder.join(format!("depth/{id:05}.png")), &depth, DEPTH_SCALE).unwrap();
            write_mask(&folder.join(format!("masks/{id:05}.png")), &mask).unwrap();
        }
    }

    #[test]
    fn frames_have_metres_and_relative_poses() {
        let folder = tempfile::tempdir().unwrap();
        // Frame 7: camera moved by 10 cm along x and turned by a quarter about z. Frame 3 has no files.
        write(folder.path(), &format!("0 {IDENTITY}\n3 {IDENTITY}\n7 0 -1 0 0.1 1 0 0 0 0 0 1 0 0 0 0 1\n"));
        let sequence = PhoneSequence::open(folder.path()).unwrap();
        assert_eq!(sequence.frame_ids().collect::<Vec<_>>(), [0, 7]);
        let (frame, mask) = sequence.load(7).unwrap();
        assert_eq!((frame.depth.get(2, 1), mask.count()), (0.75, 1));
        assert_eq!(frame.intrinsics, Intrinsics { fx: 50.0, fy: 60.0, cx: 1.5, cy: 1.0 });
        // A point 10 cm to the right of camera 0 lies in the middle of camera 7's axis.
        let t = sequence.relative_pose(7, 0).unwrap();
        assert!(t.transform(&nalgebra::Point3::new(0.1, 0.0, 2.0)).coords.xy().norm() < 1e-12);
        assert!((t.rotation_angle_deg(&Pose::identity()) - 90.0).abs() < 1e-9);
        let message = sequence.load(3).unwrap_err().to_string();
        assert!(message.contains("frame 3 not found (2 frames, 0 to 7)"), "{message}");
        let turned = r#"{"w": 3, "h": 4, "K": [50, 0, 0, 0, 60, 0, 1.5, 1, 1]}"#;
        std::fs::write(folder.path().join("metadata"), turned).unwrap();
        let message = PhoneSequence::open(folder.path()).unwrap().load(0).unwrap_err().to_string();
        assert!(message.contains("size is 3 x 4") && message.contains("4 x 3"), "{message}");
    }

    #[test]
    fn broken_sequences_name_file_and_line() {
        let folder = tempfile::tempdir().unwrap();
        let fails = |part: &str| {
            let message = PhoneSequence::open(folder.path()).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        };
        fails("metadata");
        write(folder.path(), &format!("0 {IDENTITY}\n7 1 0 nan"));
        fails("cam_poses.txt: line 2: line is 7 1 0 nan");
        write(folder.path(), &format!("0 {IDENTITY}\n0 {IDENTITY}"));
        fails("line 2");
        write(folder.path(), "0 2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1");
        fails("rigid");
        // A matrix written column by column.
        write(folder.path(), "0 1 0 0 0 0 1 0 0 0 0 1 0 0.1 0 0 1");
        fails("row-major");
        write(folder.path(), &format!("3 {IDENTITY}"));
        fails("frames not found");
        std::fs::write(folder.path().join("masks/7.png"), "").unwrap();
        fails("masks: frame 7 is");
        let metadata = folder.path().join("metadata");
        std::fs::write(&metadata, r#"{"K": [50, 0, 1.5, 0, 60, 1, 0, 0, 1]}"#).unwrap();
        fails("column by column");
        std::fs::write(&metadata, r#"{"K": [50, 0, 0, 0, NaN, 0, 1.5, 1, 1]}"#).unwrap();
        fails("K[4]: invalid type: string \"NaN\"");
        std::fs::write(folder.path().join("metadata"), r#"{"K": [1, 2]}"#).unwrap();
        fails("K is [1.0, 2.0]");
    }
}
