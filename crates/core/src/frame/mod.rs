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

    /// All points of a mask with a depth measurement, metres, camera frame, row by row. Pixels of the mask outside the
    /// depth image have none.
    pub fn masked_points(&self, mask: &Mask) -> Vec<[f32; 3]> {
        let DepthMap { width, height, .. } = self.depth;
        mask.pixels()
            .filter(|&(col, row)| col < width && row < height)
            .filter_map(|(col, row)| {
                let depth = Some(self.depth.get(col, row)).filter(|z| z.is_finite() && *z > 0.0)?;
                let p = self.intrinsics.back_project(col.into(), row.into(), depth.into());
                Some([p.x as f32, p.y as f32, p.z as f32])
            })
            .collect()
    }
}

/// An object in a view.
#[derive(Clone, Copy, Debug)]
pub struct MaskedView<'a> {
    pub frame: &'a RgbdFrame,
    pub mask: &'a Mask,
}

impl MaskedView<'_> {
    /// All measured points of the object, metres, camera frame.
    pub fn points(&self) -> Vec<[f32; 3]> {
        self.frame.masked_points(self.mask)
    }
}
