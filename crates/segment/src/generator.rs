//! What makes proposals.

use unopose_core::frame::RgbdFrame;

use super::{
    SegmentError,
    prompt::{Prompt, select_by_prompt},
    proposal::{ImageKey, Proposal},
};

/// Proposes masks of an image, best first, at most [`crate::MAX_PROPOSALS`]. `image` says which image of a dataset it is,
/// for generators that look results up.
pub trait ProposalGenerator: Send + Sync {
    /// A short name of letters, digits and dashes, for tables and folders.
    fn name(&self) -> String;

    /// Everything that decides about the proposals besides the image.
    fn fingerprint(&self) -> String {
        self.name()
    }

    /// The candidates of one image.
    fn proposals(&self, frame: &RgbdFrame, image: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError>;

    /// The mask that a point or a box means: one of the proposals, or their union.
    fn segment_prompt(&self, frame: &RgbdFrame, prompt: Prompt) -> Result<Proposal, SegmentError> {
        prompt.check(frame.width(), frame.height())?;
        let proposals = self.proposals(frame, None)?;
        if proposals.is_empty() {
            return Err(SegmentError::NotFound { image: "the image".into(), proposals: 0, best: None });
        }
        select_by_prompt(&proposals, prompt, frame.width(), frame.height())
    }
}
