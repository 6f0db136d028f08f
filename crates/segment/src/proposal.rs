//! Candidate masks of an image.

use unopose_core::frame::{BoundingBox, Mask};
use unopose_dataset::formats::{detections::Detection, rle::Rle};

/// Largest number of proposals of an image.
pub const MAX_PROPOSALS: usize = 100;

/// Scene id and image id in a dataset.
pub type ImageKey = (u32, u32);

/// A candidate mask.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// Of the size of the image, with at least one pixel.
    pub mask: Mask,
    /// Smallest box around the mask, pixels.
    pub bounds: BoundingBox,
    /// How much it looks like an object of any kind, in [0, 1]; comparable within an image.
    pub score: f32,
}

impl Proposal {
    /// A proposal with the bounds of its mask; `None` for an empty mask.
    pub fn new(mask: Mask, score: f32) -> Option<Self> {
        Some(Self { bounds: mask.bounding_box()?, mask, score })
    }

    /// The proposal as an entry of a list of detections; `time` is the time of its image, seconds, or -1.
    pub fn detection(
        &self,
        scene_id: u32,
        image_id: u32,
        category_id: u32,
        score: f64,
        time: f64,
    ) -> Detection {
        let b = &self.bounds;
        Detection {
            scene_id,
            image_id,
            category_id,
            bbox: [b.col_min, b.row_min, b.col_max - b.col_min, b.row_max - b.row_min].map(f64::from),
            score,
            time,
            segmentation: Rle::encode_compressed(&self.mask),
        }
    }
}
