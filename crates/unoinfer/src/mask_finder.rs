//! The masks of one reference's object in query views, for `estimate` and `segment`.

use std::path::Path;

use unopose_cli::say;
use unopose_core::frame::{MaskedView, RgbdFrame};
use unopose_dataset::formats::{FormatError, image_io::write_mask};
use unopose_infer::{View, ViewFiles};
use unopose_segment::{AnyMatcher, AnyObject, Matcher, Proposal, ProposalGenerator, SegmentError, UnoSeg};

/// UNOSeg with one reference, which is prepared once for all query views.
pub struct MaskFinder<'a> {
    unoseg: UnoSeg<'a, AnyMatcher<'a>>,
    object: AnyObject,
}

/// The object's instances in an image.
#[derive(Debug)]
pub struct FoundMasks {
    /// By descending score, at least one.
    pub instances: Vec<(Proposal, f64)>,
    /// Seconds that it took, proposals included.
    pub seconds: f64,
}

impl<'a> MaskFinder<'a> {
    pub fn new(
        generator: &'a dyn ProposalGenerator,
        matcher: &'a AnyMatcher<'a>,
        reference: MaskedView,
    ) -> Result<Self, SegmentError> {
        let object = matcher.object(&[reference])?;
        Ok(Self { unoseg: UnoSeg { generator, matcher }, object })
    }

    /// Detections that are instances; an error where the object is not in the image. `image` is for messages.
    pub fn find(&self, frame: &RgbdFrame, image: &Path) -> Result<FoundMasks, SegmentError> {
        let found = self.unoseg.instances(frame, &self.object, &image.display().to_string())?;
        let instances = found.found.into_iter().map(|object| (object.mask, object.score)).collect();
        Ok(FoundMasks { instances, seconds: found.seconds })
    }

    /// The query view with the masks that are found in it, which are written to `OUT/mask_N.png` as well, and their scores.
    pub fn complete(
        &self,
        mut view: View,
        files: &ViewFiles,
        out: &Path,
    ) -> anyhow::Result<(View, ViewFiles, Vec<f64>)> {
        if view.frame.depth.data.iter().all(|z| !(z.is_finite() && *z > 0.0)) {
            let expected = "at least one measured pixel";
            return Err(FormatError::field(files.depth.display(), "depth image", "empty", expected).into());
        }
        let found = self.find(&view.frame, &files.rgb)?;
        let (mut masks, mut scores) = (Vec::new(), Vec::new());
        for (index, (proposal, score)) in found.instances.into_iter().enumerate() {
            let path = out.join(format!("mask_{index}.png"));
            write_mask(&path, &proposal.mask)?;
            say!("{}: segmentation score {score:.3}, {:.3} s", path.display(), found.seconds);
            masks.push(path);
            scores.push(score);
            view.masks.push(proposal.mask);
        }
        Ok((view, ViewFiles { masks, ..files.clone() }, scores))
    }
}
