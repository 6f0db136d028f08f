//! Proposals, matching and assignment together.

use std::time::Instant;

use unopose_core::frame::RgbdFrame;

use super::{
    ImageKey, Matcher, Proposal, ProposalGenerator, SegmentError,
    assignment::{Assignment, assign},
};

/// A proposal generator with a matcher.
pub struct UnoSeg<'a, M: Matcher> {
    /// Finds the candidate masks.
    pub generator: &'a dyn ProposalGenerator,
    /// Compares them with the objects.
    pub matcher: &'a M,
}

/// What was found in an image.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ImageSegmentation {
    /// All candidate masks, best first.
    pub proposals: Vec<Proposal>,
    /// The proposals that are objects, by descending score.
    pub assignments: Vec<Assignment>,
    /// Time of the proposals, seconds.
    pub proposal_seconds: f64,
    /// Time of proposals, matching and assignment, seconds.
    pub seconds: f64,
}

impl<M: Matcher> UnoSeg<'_, M> {
    /// Everything that decides about a result besides the images.
    pub fn fingerprint(&self) -> String {
        format!("{} {}", self.generator.fingerprint(), self.matcher.fingerprint())
    }

    /// Finds objects in an image. An image without proposals has none of them.
    pub fn segment(
        &self,
        frame: &RgbdFrame,
        image: Option<ImageKey>,
        objects: &[&M::Object],
    ) -> Result<ImageSegmentation, SegmentError> {
        let start = Instant::now();
        let proposals = self.generator.proposals(frame, image)?;
        let proposal_seconds = start.elapsed().as_secs_f64();
        let assignments = match proposals.is_empty() || objects.is_empty() {
            true => Vec::new(),
            false => assign(&proposals, &self.matcher.scores(frame, &proposals, objects)?),
        };
        Ok(ImageSegmentation {
            proposals,
            assignments,
            proposal_seconds,
            seconds: start.elapsed().as_secs_f64(),
        })
    }
}
