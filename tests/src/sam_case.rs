//! Small Segment Anything networks with what their original implementation makes of one image.

use std::path::PathBuf;

use image::RgbImage;
use safetensors::SafeTensors;
use tempfile::TempDir;
use unopose_core::{
    frame::{DepthMap, RgbdFrame},
    geometry::Intrinsics,
};

use crate::{fixture, reference_tensors::ReferenceTensors};

/// A network with random weights and its results on an image of 72 x 50 pixels.
pub struct SamCase {
    pub file: ReferenceTensors,
    /// Holds [`Self::weights`].
    pub folder: TempDir,
}

impl SamCase {
    /// `sam_vit` or `sam_tiny_vit`.
    pub fn open(name: &str) -> Self {
        let case = Self { file: ReferenceTensors::open(name), folder: tempfile::tempdir().unwrap() };
        let bytes = std::fs::read(fixture(&format!("{name}.safetensors"))).unwrap();
        let all = SafeTensors::deserialize(&bytes).unwrap();
        let weights = all.iter().filter_map(|(name, view)| Some((name.strip_prefix("weights.")?, view)));
        std::fs::write(case.weights(), safetensors::serialize(weights, None).unwrap()).unwrap();
        case
    }

    /// The weights as a file of their own.
    pub fn weights(&self) -> PathBuf {
        self.folder.path().join("sam.safetensors")
    }

    /// The image, without depth.
    pub fn frame(&self) -> RgbdFrame {
        let (shape, values) = self.file.int("image");
        let (width, height) = (shape[1] as u32, shape[0] as u32);
        let rgb = RgbImage::from_raw(width, height, values.iter().map(|&v| v as u8).collect()).unwrap();
        let intrinsics = Intrinsics { fx: 80.0, fy: 80.0, cx: 36.0, cy: 25.0 };
        RgbdFrame { depth: DepthMap::zeros(width, height), rgb, intrinsics }
    }
}
