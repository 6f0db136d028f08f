//! Candidate masks of an image and what makes them.

use unopose_core::frame::{BoundingBox, Mask, RgbdFrame};

use super::{Prompt, SegmentError, select_by_prompt};

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
}

/// Proposes masks of an image, best first, at most [`MAX_PROPOSALS`]. `image` says which image of a
/// dataset it is, for generators that look results up.
pub trait ProposalGenerator: Send + Sync {
    /// Short, of letters, digits and dashes.
    fn name(&self) -> String;

    /// Everything that decides about the proposals besides the image.
    fn fingerprint(&self) -> String {
        self.name()
    }

    fn proposals(&self, frame: &RgbdFrame, image: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError>;

    /// The mask that a point or a box means: one of the proposals, or their union.
    fn segment_prompt(&self, frame: &RgbdFrame, prompt: Prompt) -> Result<Proposal, SegmentError> {
        prompt.check(frame.width(), frame.height())?;
        let proposals = self.proposals(frame, None)?;
        if proposals.is_empty() {
            return Err(SegmentError::NotFound { image: "the image".into(), proposals: 0 });
        }
        select_by_prompt(&proposals, prompt, frame.width(), frame.height())
    }
}
