//! Proposals, matching and assignment together.

use std::time::Instant;

use unopose_core::frame::RgbdFrame;

use super::{ImageKey, Matcher, Proposal, ProposalGenerator, SegmentError, assignment::assign};

/// Score of a second instance of an object: it has to be more likely one than not.
const FURTHER: f64 = 0.5;

/// A proposal generator with a matcher.
pub struct UnoSeg<'a, M: Matcher> {
    /// Finds the candidate masks.
    pub generator: &'a dyn ProposalGenerator,
    /// Compares them with the objects.
    pub matcher: &'a M,
}

/// An object in an image.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct FoundObject {
    /// Index in the list of objects.
    pub object: usize,
    /// The matcher's score, in [0, 1].
    pub score: f64,
    /// Its mask: a proposal's, cut anew by the object's pose where the matcher has one.
    pub mask: Proposal,
}

/// What was found in an image.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ImageSegmentation {
    /// All candidate masks, best first.
    pub proposals: Vec<Proposal>,
    /// The objects, by descending score.
    pub found: Vec<FoundObject>,
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
        let found = match proposals.is_empty() || objects.is_empty() {
            true => Vec::new(),
            false => self.found(frame, &proposals, objects)?,
        };
        Ok(ImageSegmentation { proposals, found, proposal_seconds, seconds: start.elapsed().as_secs_f64() })
    }

    /// [`Self::segment`] for one object, of which only the instances are kept: what reaches the matcher's score of an instance, or
    /// the best detection of a matcher that knows no absence; further ones where they are more likely than not. An error when
    /// there is none; `image` is for its message.
    pub fn instances(
        &self,
        frame: &RgbdFrame,
        object: &M::Object,
        image: &str,
    ) -> Result<ImageSegmentation, SegmentError> {
        let mut segmented = self.segment(frame, None, &[object])?;
        let least = self.matcher.instance_score();
        let best = segmented.found.first().map(|best| (best.score, least));
        let is_there = !self.matcher.knows_absence() || best.is_some_and(|(score, least)| score >= least);
        if !is_there || segmented.found.is_empty() {
            let (image, proposals) = (image.to_owned(), segmented.proposals.len());
            return Err(SegmentError::NotFound { image, proposals, best });
        }
        let further =
            segmented.found.iter().skip(1).take_while(|found| found.score >= least.max(FURTHER)).count();
        segmented.found.truncate(1 + further);
        Ok(segmented)
    }

    /// Compares, assigns and cuts the masks anew.
    fn found(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&M::Object],
    ) -> Result<Vec<FoundObject>, SegmentError> {
        let compared = self.matcher.compare(frame, proposals, objects)?;
        let scores: Vec<Vec<f64>> =
            compared.iter().map(|row| row.iter().map(|c| c.score).collect()).collect();
        let found = assign(proposals, &scores).into_iter().map(|assigned| {
            let proposal = &proposals[assigned.proposal];
            let pose = compared[assigned.object][assigned.proposal].t_query_reference;
            let object = objects[assigned.object];
            let cut = pose.and_then(|pose| self.matcher.recut(frame, &proposal.mask, object, &pose));
            let mask = cut.and_then(|mask| Proposal::new(mask, proposal.score));
            FoundObject {
                object: assigned.object,
                score: assigned.score,
                mask: mask.unwrap_or_else(|| proposal.clone()),
            }
        });
        Ok(found.collect())
    }
}
