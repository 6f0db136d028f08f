//! Candidate masks of an image.

use unopose_core::frame::{BoundingBox, Mask};
use unopose_dataset::formats::{detections::Detection, rle::Rle};

/// Proposals per image at most.
pub const MAX_PROPOSALS: usize = 100;

/// Scene and image of a dataset.
pub type ImageKey = (u32, u32);

/// A candidate mask.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    pub mask: Mask,
    pub bounds: BoundingBox,
    /// How much it looks like an object of any kind, in [0, 1]; comparable within an image.
    pub score: f32,
}

impl Proposal {
    /// `None` for an empty mask.
    pub fn new(mask: Mask, score: f32) -> Option<Self> {
        Some(Self { bounds: mask.bounding_box()?, mask, score })
    }

    /// The proposal in the list format of detections.
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
