//! One RGB-D view in memory: colour, depth in metres, masks, intrinsics.

mod depth;
mod mask;

pub use depth::DepthMap;
pub use mask::{BoundingBox, Mask};

use crate::geometry::Intrinsics;

/// A registered colour and depth image pair of one camera. Both have the same size.
#[derive(Clone, Debug)]
pub struct RgbdFrame {
    pub rgb: image::RgbImage,
    pub depth: DepthMap,
    pub intrinsics: Intrinsics,
}

impl RgbdFrame {
    pub fn width(&self) -> u32 {
        self.rgb.width()
    }

    pub fn height(&self) -> u32 {
        self.rgb.height()
    }
}
