//! One RGB-D view in memory: colour, depth in metres, masks, intrinsics.

mod depth;
mod mask;
mod undistortion;

pub use depth::DepthMap;
pub use mask::{BoundingBox, Mask};
pub use undistortion::Undistortion;

use crate::geometry::Intrinsics;

/// A registered colour and depth image pair of one camera. Both have the same size.
#[derive(Clone, Debug)]
pub struct RgbdFrame {
    /// Colour, 8 bits per channel, sRGB.
    pub rgb: image::RgbImage,
    /// Depth in metres, registered to the colour image.
    pub depth: DepthMap,
    /// Pinhole camera of both images.
    pub intrinsics: Intrinsics,
}

impl RgbdFrame {
    /// Columns of the colour image.
    pub fn width(&self) -> u32 {
        self.rgb.width()
    }

    /// Rows of the colour image.
    pub fn height(&self) -> u32 {
        self.rgb.height()
    }

    /// The frame as the pinhole camera would have taken it, without what the lens did.
    pub fn undistorted(&self, lens: &Undistortion) -> Self {
        Self { rgb: lens.color(&self.rgb), depth: lens.depth(&self.depth), intrinsics: self.intrinsics }
    }

    /// Column, row and depth (metres) of the pixels of a mask that have a measurement, row by row. Pixels of the mask outside
    /// the depth image have none.
    pub fn measured_pixels<'a>(&'a self, mask: &'a Mask) -> impl Iterator<Item = (u32, u32, f32)> + 'a {
        let DepthMap { width, height, .. } = self.depth;
        let inside = mask.pixels().filter(move |&(col, row)| col < width && row < height);
        let measured = inside.map(|(col, row)| (col, row, self.depth.get(col, row)));
        measured.filter(|(.., z)| z.is_finite() && *z > 0.0)
    }

    /// Median depth of a mask's measured pixels, metres; `None` where fewer than `least` are measured.
    pub fn median_depth(&self, mask: &Mask, least: usize) -> Option<f64> {
        let mut depths: Vec<f32> = self.measured_pixels(mask).map(|(.., z)| z).collect();
        let middle = depths.len() / 2;
        (depths.len() >= least.max(1))
            .then(|| f64::from(*depths.select_nth_unstable_by(middle, f32::total_cmp).1))
    }

    /// All measured points of a mask, metres, camera frame, row by row.
    pub fn masked_points(&self, mask: &Mask) -> Vec<[f32; 3]> {
        let point = |(col, row, depth): (u32, u32, f32)| {
            let p = self.intrinsics.back_project(col.into(), row.into(), depth.into());
            [p.x as f32, p.y as f32, p.z as f32]
        };
        self.measured_pixels(mask).map(point).collect()
    }
}

/// An object in a view.
#[derive(Clone, Copy, Debug)]
pub struct MaskedView<'a> {
    /// The view, with everything around the object.
    pub frame: &'a RgbdFrame,
    /// The object's visible pixels, as large as the frame.
    pub mask: &'a Mask,
}

impl MaskedView<'_> {
    /// All measured points of the object, metres, camera frame.
    pub fn points(&self) -> Vec<[f32; 3]> {
        self.frame.masked_points(self.mask)
    }
}
