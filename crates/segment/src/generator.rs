//! What makes proposals.

use unopose_core::frame::RgbdFrame;

use super::{ImageKey, Prompt, Proposal, SegmentError, select_by_prompt};

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
